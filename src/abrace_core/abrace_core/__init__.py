"""The base of all packages: models with named signals, their simulation, safety checks, and the node conventions."""
