"""Starting points of searches, for files of effects in other packages."""

from skincal.effects.parameter import Scene, Start, start

__all__ = ["Scene", "Start", "start"]
