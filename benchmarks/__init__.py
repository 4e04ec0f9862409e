"""Benchmarks of skincal: speed, and synthetic sessions with a known truth (``python -m benchmarks.NAME``)."""
