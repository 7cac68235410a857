"""Files of recorded ground motions to accelerations for the table, with their measures and spectra."""
