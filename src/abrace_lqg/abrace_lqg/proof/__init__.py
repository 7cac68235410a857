"""A designed controller and models of the structure to the proof of it: numbers, table, figures, files."""
