"""Compiled presses: distances, equilibrium and sums in one scalar loop (paper, section II-A).

:mod:`~skincal.model.press.call` is the interface and imports nothing slow. numba compiles the other modules at the
first press, and caches the result for later processes.
"""
