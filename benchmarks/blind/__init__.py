"""The blind test of ``skincal diagnose``: sessions with a hidden effect, their run, and their score.

``python -m benchmarks.blind make`` writes one session to look at; ``run`` makes, fits and diagnoses the sessions of all
suites (:mod:`benchmarks.blind.suites`), with what is hidden in them sealed; ``score`` opens the labels and says what
was found. The sessions come from :mod:`benchmarks.blind.truth`, which shares no code with skincal.
"""
