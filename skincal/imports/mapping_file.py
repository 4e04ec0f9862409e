"""The schema of mapping files: tables of columns, taxels, frames, text files and bags."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import date, datetime
from typing import Annotated, Any, Literal

from skincal.dataset.keys import Key, Texts, When, Word
from skincal.dataset.schema import Table
from skincal.dataset.schema_errors import Violation
from skincal.dataset.spec import Description
from skincal.dataset.word_checks import WIDTHS
from skincal.imports.mapping import (
    BagEntry,
    ClockKind,
    CsvEntry,
    CsvSource,
    CutRules,
    Entry,
    JoinedFormat,
    Named,
    Resampling,
)

PATTERN = (
    'a pattern like "tax_{r}_{c}", "p{R}{c}" or "s{j}", a list of all columns, or a list of rows of them'
)
VECTORS = 'a pattern like "S-{axis}[{j}]" with axes, or a list of a list of columns for each taxel'
WORDS = tuple(f"{sign}int{bits}" for bits in WIDTHS for sign in ("u", ""))

_Rows = tuple[tuple[str, ...], ...]
_Triple = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class TaxelTable(Table, unknown="refuse"):
    """``[taxels]``: the image of the source, which is transposed, then flipped, to be that of the dataset."""

    order: Annotated[
        Literal["rows", "columns"] | tuple[int, ...],
        Key('"rows", "columns", or the indices of all taxels from 0 on, each once'),
    ] = "rows"
    transpose: bool = False
    flip_rows: bool = False
    flip_cols: bool = False
    scale: float = 1.0
    offset: float = 0.0
    falling_from: float | None = None
    word: Annotated[str, Word(options=WORDS)] = ""
    swap_bytes: bool = False


@dataclass(frozen=True, kw_only=True)
class CsvTaxels(TaxelTable):
    """``[taxels]`` of text files: the columns, by a pattern or a list."""

    columns: Annotated[str | tuple[str, ...] | _Rows | None, Key(PATTERN)] = None
    first: Annotated[int, Key("the first number of rows, columns or taxels, like 0 or 1")] = 0
    vectors: Annotated[str | _Rows | None, Key(VECTORS)] = None
    axes: Named = ()
    rest_rows: Annotated[int, Key("a number of rows, at least 1", 1)] = 50


@dataclass(frozen=True, kw_only=True)
class BagTaxels(TaxelTable):
    """``[taxels]`` of bags: the array in the messages of a topic, or some of its elements."""

    topic: Annotated[str, Key("the topic's name")]
    field: Annotated[str, Key("the path of the array, like data")]
    elements: Annotated[tuple[int, ...] | None, Key("indices of the array")] = None


@dataclass(frozen=True)
class Frame(Table, unknown="refuse"):
    """``[frame]``: from points of the source to the fingertip frame."""

    matrix: Annotated[tuple[_Triple, _Triple, _Triple] | None, Key("three rows of three numbers")] = None
    rotation_deg: Annotated[_Triple | None, Key("three angles about x, y, z [deg]")] = None
    quaternion_xyzw: Annotated[tuple[float, float, float, float] | None, Key("four numbers x, y, z, w")] = (
        None
    )
    translation_m: Annotated[_Triple, Key("three numbers [m]")] = (0.0, 0.0, 0.0)
    project: bool = False

    def violations(self) -> Iterator[Violation]:
        """Yield several forms of the rotation, a quaternion of another length, and millimetres."""
        names = ("matrix", "rotation_deg", "quaternion_xyzw")
        given = [name for name in names if getattr(self, name) is not None]
        if len(given) > 1:
            yield given[1], "one form of the rotation", " and ".join(given), "Remove the others."
        if self.quaternion_xyzw is not None and abs(math.hypot(*self.quaternion_xyzw) - 1) > 1e-3:
            yield "quaternion_xyzw", "a quaternion of length 1", self.quaternion_xyzw
        if max(map(abs, self.translation_m)) > 10:
            fix = "It looks like millimetres; divide by 1000."
            yield "translation_m", "at most 10 m", self.translation_m, fix


@dataclass(frozen=True)
class TopicTable(Table, unknown="refuse"):
    """A table of ``[topics]``; what it leaves out is that of ``[bag]``."""

    clock: ClockKind | None = None
    resample: Resampling | None = None
    max_age_s: Annotated[float | None, Key("a time [s], 0 or more", 0.0)] = None
    lag_s: float = 0.0


@dataclass(frozen=True)
class BagTable(Table, unknown="refuse"):
    """``[bag]``: the bags, and the rules of topics without their own."""

    clock: ClockKind
    files: Annotated[tuple[str, ...], Texts("names of bags")] = ()
    resample: Resampling = "previous"
    max_age_s: Annotated[float, Key("a time [s], 0 or more", 0.0)] = 0.1
    definitions: Annotated[Mapping[str, str], Key('a table like { "my_msgs/msg/Skin" = "Skin.msg" }')] = (
        field(default_factory=dict[str, str])
    )

    def violations(self) -> Iterator[Violation]:
        """Yield names that are none of a type."""
        for name, file in self.definitions.items():
            if name.count("/") not in (1, 2):
                expected = 'a type like "my_msgs/msg/Skin" and a file'
                yield "definitions", expected, f"{name} = {file}"


@dataclass(frozen=True)
class JointTable(Table, unknown="refuse"):
    """``[joints]``: the topic of ``sensor_msgs/JointState``, and the joints in their order."""

    topic: Annotated[str, Key("the topic's name")]
    names: Annotated[tuple[str, ...], Texts("names of joints")] = ()


@dataclass(frozen=True, kw_only=True)
class MappingFile(Description, unknown="refuse"):
    """What mapping files of all sources have."""

    created: Annotated[datetime | date | None, When()] = None
    source: str = ""
    assumed: Annotated[tuple[str, ...], Texts('a list of texts like ["force_n"]')] = ()
    columns: Mapping[str, Entry] = field(default_factory=dict[str, Entry])
    frame: Frame = field(default_factory=Frame)
    series: CutRules | None = None
    taxels: TaxelTable


@dataclass(frozen=True, kw_only=True)
class CsvMapping(MappingFile):
    """A mapping of text files."""

    columns: Mapping[str, CsvEntry] = field(default_factory=dict[str, Any])
    taxels: CsvTaxels
    csv: CsvSource
    files: Mapping[str, JoinedFormat] = field(default_factory=dict[str, JoinedFormat])


@dataclass(frozen=True, kw_only=True)
class BagMapping(MappingFile):
    """A mapping of bags."""

    columns: Mapping[str, BagEntry] = field(default_factory=dict[str, Any])
    taxels: BagTaxels
    bag: BagTable
    topics: Mapping[str, TopicTable] = field(default_factory=dict[str, TopicTable])
    joints: JointTable | None = None
