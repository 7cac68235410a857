"""A campaign file to the bags, models, controllers and comparisons of its steps."""
