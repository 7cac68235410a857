"""Transfer functions and spectra to poles, with their confidence intervals."""
