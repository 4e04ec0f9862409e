"""Which effects a session shows: one model of observations, one score, one null, one search. Arrays in, arrays out.

Read in this order: ``forward`` (what a state of the sensor reads, from ``tables`` of loads over force), ``blocks``
(every press whitened, its own numbers integrated out), ``fit`` (the joint fit), ``score``, ``null`` (with ``twins`` of
other contact laws), ``search``, ``check``. All hand-set numbers are in ``constants``. Columns of effects
(``columns``) are differences of the effects' own equations, from the starts that each effect declares.

State of the work. Sessions of frames and of hold means, clipped or not, in steps, with growing noise, go through. Not
done: equations of a drift that is taken off again and again and of exchanged wires; stuck spells and jumps of single
taxels as findings; the contact law of a layer as a part of the calibration; effects of single taxels by their sparse
columns, which large sensors need to be quick; an ablation over several hundred sessions.
"""
