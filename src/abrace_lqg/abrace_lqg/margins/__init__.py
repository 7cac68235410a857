"""A sampled loop to its margins: stability, damping, lost samples, predicted responses."""
