"""The fit: a macro grid with micro problems inside, and the posterior of the valley."""
