"""Models to controllers: LQG design, margins, the run-time law and its parameter file."""
