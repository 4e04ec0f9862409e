"""Inference of the effects that a session shows: one observation model, one score, one null, one search; arrays only.

Read in this order: ``forward`` (the prediction of a state, from a ``press_table`` of loads over force), ``blocks``
(normal equations of each press, its nuisance parameters integrated out), ``fit`` (the joint fit), ``score``, ``null``
(with ``twins`` under other contact laws), ``candidate_scores``, ``candidate_fits``, ``search``. All
constants of the method are in ``constants``. Columns of effects (``columns``) are differences of the effects' own
equations, from the starts that each effect declares.
"""
