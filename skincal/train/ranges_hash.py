"""A name for ranges that depends on what they say alone."""

from __future__ import annotations

import hashlib
import json

from skincal.ranges import Ranges
from skincal.ranges.plain import to_plain


def ranges_hash(ranges: Ranges) -> str:
    """SHA-256 of what ranges say, whatever file they come from and in whatever order."""
    text = json.dumps(to_plain(ranges), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
