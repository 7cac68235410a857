"""Transfer functions and spectra to poles and residues, with their certainty."""
