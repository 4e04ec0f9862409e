"""The fit: a macro grid, micro variables inside it, and the posterior of the valley."""
