"""Where simulation and data disagree: what a session can show at all, and what noise hides. Arrays in, arrays out."""
