"""Which effects a session shows: one model of observations, one score, one null, one search. Arrays in, arrays out.

Read in this order: ``forward`` (what a state of the sensor reads, from a ``press_table`` of loads over force),
``blocks`` (every press whitened, its own numbers integrated out), ``fit`` (the joint fit), ``score``, ``null`` (with
``twins`` of other contact laws), ``search``, ``check``. All hand-set numbers are in ``constants``. Columns of effects
(``columns``) are differences of the effects' own equations, from the starts that each effect declares.

Not covered: equations of a drift that is taken off again and again and of exchanged wires; the contact law of a layer
as a part of the calibration; sparse columns for effects of single taxels, without which sensors of hundreds of taxels
need more memory than most machines have.
"""
