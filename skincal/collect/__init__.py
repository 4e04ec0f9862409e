"""Data collection: plans of presses, and their execution with a hand, which gives a dataset."""

from skincal.collect.collection import Collected, collect
from skincal.collect.journal import discard_session, journal_folder
from skincal.collect.plan import KINDS, CollectOptions, Plan, PlannedPress
from skincal.collect.plan_file import read_plan, write_plan
from skincal.collect.posture import Mount
from skincal.collect.protocols import PROTOCOLS, FullProtocol, PaperProtocol, full_plan, paper_plan
from skincal.collect.session import MakeDriver, Need, Progress

__all__ = [
    "KINDS", "PROTOCOLS", "CollectOptions", "Collected", "FullProtocol", "MakeDriver", "Mount", "Need",
    "PaperProtocol", "Plan", "PlannedPress", "Progress", "collect", "discard_session", "full_plan",
    "journal_folder", "paper_plan", "read_plan", "write_plan",
]  # fmt: skip
