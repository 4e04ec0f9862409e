"""The blind test of ``skincal diagnose``: sessions with a hidden effect (``python -m benchmarks.blind make``).

They come from :mod:`benchmarks.blind.truth`, which shares no code with skincal.
"""
