"""What skincal is measured by: speed, and synthetic sessions with their truth (``python -m benchmarks.NAME``)."""
