"""One press, compiled: distances, equilibrium and sums as one scalar loop (paper, section II-A).

:mod:`~skincal.model.press.call` is the door; it imports nothing slow. The other modules are compiled by numba when the
first press is computed, and the result is kept for later processes.
"""
