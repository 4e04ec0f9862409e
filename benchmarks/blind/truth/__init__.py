"""Makes sessions with something hidden in them. Imports nothing of skincal.

Its equations were written to be others than skincal's; where skincal's have come near, these have been written anew.

The flow is one way: a :mod:`protocol <benchmarks.blind.truth.protocol>` says which presses there are and when; a
:mod:`body <benchmarks.blind.truth.body>` is the sensor's pose, its scale and its contact law; the
:mod:`chain <benchmarks.blind.truth.chain>` turns forces and places into counts, through the hidden effects; their
strength is set by :mod:`strength <benchmarks.blind.truth.strength>`; :mod:`session <benchmarks.blind.truth.session>`
puts a session and its label together, and :mod:`writing <benchmarks.blind.truth.writing>` puts them on disk.
"""
