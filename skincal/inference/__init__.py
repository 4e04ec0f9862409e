"""Which effects a session shows: one model of observations, one score, one null, one search. Arrays in, arrays out."""
