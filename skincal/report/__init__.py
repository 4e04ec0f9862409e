"""Figures and pages from results; the only user of matplotlib and jinja2."""
