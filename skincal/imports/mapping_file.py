"""The schema of mapping files: tables of columns, taxels, frames, text files and bags."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import date, datetime
from typing import Annotated, Any, Final, Literal

import numpy as np

from skincal.dataset.keys import Key, Texts, When, Word
from skincal.dataset.schema import Table
from skincal.dataset.schema_errors import Violation
from skincal.dataset.spec import Description
from skincal.dataset.word_checks import WIDTHS
from skincal.imports.recording import FloatArray

FORMAT: Final = "skincal-import/1"

Rows = Literal["presses", "series"]
By = Literal["force", "taxels", "plateaus", "press"]
ClockKind = Literal["header", "receive"]
Resampling = Literal["previous", "linear"]
Layout = Literal["table", "blocks", "labelled"]
Order = Literal["file", "time"]
Slides = Literal["cut", "keep", "refuse"]
Count = Annotated[int, Key("a whole number, 0 or more", 0)]
_Triple = tuple[float, float, float]
_Time = Annotated[float, Key("a time [s], 0 or more", 0.0)]


@dataclass(frozen=True)
class CutRules(Table, unknown="refuse"):
    """Rules for cutting a time series into presses; ``docs/import.md`` explains the keys.

    A contact is a stretch of force above ``off_n`` that rises above ``on_n``. ``band`` is relative to the force that is
    kept longest; a ``still_m`` of None stands for sigma_m of the positions.
    """

    by: By = "force"
    on_n: Annotated[float, Key("a force [N], 0 or more", 0.0)] = 0.2
    off_n: float = 0.1
    band: Annotated[float, Key("a share of the force, like 0.1", 0.0)] = 0.1
    settle_s: _Time = 0.0
    min_hold_s: _Time = 0.1
    slope_n_per_s: Annotated[float, Key("a change of force [N/s], 0 or more", 0.0)] = 0.1
    window_s: _Time = 0.2
    start_at_zero: bool = True
    own_clocks: bool = False
    gap_s: _Time = 1.0
    zero_force: bool = False
    slides: Slides = "cut"
    still_m: Annotated[float | None, Key("a length [m], 0 or more", 0.0)] = None

    def violations(self) -> Iterator[Violation]:
        """Yield a band in percent."""
        if self.band >= 0.5:
            yield "band", "a share below 0.5", self.band, "It looks like percent; divide by 100."


@dataclass(frozen=True, kw_only=True)
class CsvFormat(Table, unknown="refuse"):
    """Layout of a text file; ``docs/import.md`` and the template ``csv`` explain the keys.

    ``block_rows`` of 0 reach up to the next line that is not a row; without ``rate_hz``, a column holds the time;
    ``quoted`` says that numbers are in quotes, so that the decimal mark may be the delimiter; a space as mark of
    ``thousands`` stands for any kind of space.
    """

    delimiter: str = ","
    decimal: Literal[".", ","] = "."
    quoted: bool = False
    thousands: Literal["", ".", ",", "'", "’", "_", " "] = ""
    encoding: str = "utf-8"
    comment: str = ""
    skip_rows: Count = 0
    skip_after_header: Count = 0
    header: bool = True
    missing: Annotated[tuple[str, ...], Texts("texts that mean no value")] = ("NaN", "nan", "NA")
    layout: Layout = "table"
    block_rows: Count = 0
    rate_hz: Annotated[float | None, Key("rows a second [Hz], more than 0", 1e-6)] = None
    order: Order = "file"

    @property
    def blanks(self) -> tuple[str, ...]:
        """Cells that mean no value."""
        return ("", *self.missing)

    def violations(self) -> Iterator[Violation]:
        """Yield delimiters that are not single or not unique, and unknown encodings."""
        if len(self.delimiter) != 1 and self.delimiter != "whitespace":
            expected = 'one character, like ";" or "\\t", or "whitespace"'
            yield "delimiter", expected, f'"{self.delimiter}"'
        if self.delimiter == self.decimal and not self.quoted:
            fix = 'If such numbers are quoted ("1,5"), set quoted = true in [csv].'
            yield "decimal", "another character than the delimiter", f'"{self.decimal}"', fix
        if self.thousands == self.decimal:
            yield "thousands", "another character than the decimal mark", f'"{self.thousands}"'
        try:
            "".encode(self.encoding)  # refuses codecs that are not of text like unknown ones
        except (LookupError, ValueError):
            yield "encoding", "an encoding like utf-8, utf-16 or latin-1", f'"{self.encoding}"'


DROP_INCOMPLETE = "drop_incomplete = true in [csv] leaves such rows out."
"""Advice for rows that lack a required number."""


@dataclass(frozen=True, kw_only=True)
class CsvSource(CsvFormat):
    """The text files with the taxels, relative to the mapping; incomplete rows are refused unless they are dropped."""

    rows: Rows
    files: Annotated[tuple[str, ...], Texts("names of files")] = ()
    drop_incomplete: bool = False


@dataclass(frozen=True, kw_only=True)
class Entry(Table, unknown="refuse"):
    """An entry of ``[columns]``: the source of a column, or a constant."""

    wanted = 'a table like { column = "Fz", unit = "mN" }, or for SI the name of a column'

    value: Annotated[float | str | _Triple | None, Key("a number, three numbers, or a text")] = None
    unit: Annotated[str | tuple[str, ...] | None, Key("the name of a unit")] = None
    sign: Annotated[float, Key("1 or -1", -1, 1)] = 1
    scale: float = 1.0
    offset: float = 0.0
    words: Annotated[Mapping[str, str], Key('a table like { loading = "up" }')] = field(
        default_factory=dict[str, str]
    )
    wraps_at: float | None = None
    format: str = ""


Named = Annotated[tuple[str, ...], Texts("a list of names")]


@dataclass(frozen=True, kw_only=True)
class CsvEntry(Entry):
    """An entry for text files: a column, or several, of a file of ``[files]`` or of that with the taxels."""

    file: str = ""
    column: str | None = None
    columns: Named = ()

    @property
    def source(self) -> tuple[str, str | None, Named]:
        """File, and its column or columns."""
        return self.file, self.column, self.columns


@dataclass(frozen=True, kw_only=True)
class BagEntry(Entry):
    """An entry for bags: a field of a message, or several."""

    topic: str = ""
    fields: Named = ()
    field: str | None = None

    @property
    def source(self) -> tuple[str, str | None, Named]:
        """Topic, and the field or fields of its messages."""
        return self.topic, self.field, self.fields


@dataclass(frozen=True, kw_only=True)
class JoinedFormat(CsvFormat):
    """A table of ``[files]``: a further file (or a pattern of names) with its own clock, relative to the mapping.

    ``press`` names the column of press numbers of a table with one row per press, which needs no clock.
    ``time`` is None with a fixed rate; a ``max_age_s`` of None stands for three of its own steps. ``clock`` is another
    table whose clock, and so whose offset, it has.
    """

    file: Annotated[str, Key("the name of the file, or a pattern like gauge_*.csv")]
    time: CsvEntry | None = None
    press: str = ""
    resample: Resampling = "linear"
    max_age_s: _Time | None = None
    offset_s: Annotated[float | Literal["estimate"], Key('a time [s], or "estimate"')] = 0.0
    within_s: _Time = np.inf
    clock: str = ""

    def violations(self) -> Iterator[Violation]:
        """Yield a file without stamps, and an offset besides a clock."""
        yield from super().violations()
        if self.clock and self.offset_s != 0.0:
            expected = f'none: the clock is that of "{self.clock}"'
            yield "offset_s", expected, self.offset_s, "Remove one of them."
        if self.press and (self.time is not None or self.rate_hz is not None):
            yield "press", "a clock, or numbers of presses", "both", "Remove one of them."
        if self.time is None and self.rate_hz is None and not self.press:
            fix = 'Add time, or rate_hz; for a table with one row per press, its column of numbers: press = "trial".'
            yield "time", 'its stamps, like { column = "t", unit = "s" }', "nothing", fix


PATTERN = (
    'a pattern like "tax_{r}_{c}", "p{R}{c}" or "s{j}", a list of all columns, or a list of rows of them'
)
AXES_PATTERN = 'a pattern like "S-{axis}[{j}]" with axes, or a list of a list of columns for each taxel'
WORDS = tuple(f"{sign}int{bits}" for bits in WIDTHS for sign in ("u", ""))

_Names = tuple[tuple[str, ...], ...]


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
    swap_words: bool = False


@dataclass(frozen=True, kw_only=True)
class CsvTaxels(TaxelTable):
    """``[taxels]`` of text files: the columns, by a pattern or a list."""

    columns: Annotated[str | tuple[str, ...] | _Names | None, Key(PATTERN)] = None
    first: Annotated[int, Key("the first number of rows, columns or taxels, like 0 or 1")] = 0
    vectors: Annotated[str | _Names | None, Key(AXES_PATTERN)] = None
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
        matrix = np.eye(3) if self.matrix is None else np.array(self.matrix)
        if not np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-3):
            yield "matrix", "a rotation: rows of length 1, at right angles", "something else"
        elif np.linalg.det(matrix) < 0:
            fix = "Is an axis of the source left-handed?"
            yield "matrix", "a rotation", "a reflection (determinant -1)", fix
        if max(map(abs, self.translation_m)) > 10:
            fix = "It looks like millimetres; divide by 1000."
            yield "translation_m", "at most 10 m", self.translation_m, fix

    @property
    def rotation(self) -> FloatArray:
        """R of ``p = R x + translation_m``, shape (3, 3)."""
        from scipy.spatial.transform import Rotation

        if self.rotation_deg is not None:
            return Rotation.from_euler("xyz", self.rotation_deg, degrees=True).as_matrix()
        if self.quaternion_xyzw is not None:
            return Rotation.from_quat(self.quaternion_xyzw).as_matrix()
        return np.eye(3) if self.matrix is None else np.array(self.matrix)


@dataclass(frozen=True)
class TopicRules:
    """Clock and resampling of one topic; its stamps are ``lag_s`` too late."""

    clock: ClockKind
    resample: Resampling
    max_age_s: float
    lag_s: float = 0.0


@dataclass(frozen=True)
class TopicTable(Table, unknown="refuse"):
    """A table of ``[topics]``; what it leaves out is that of ``[bag]``."""

    clock: ClockKind | None = None
    resample: Resampling | None = None
    max_age_s: _Time | None = None
    lag_s: float = 0.0


@dataclass(frozen=True)
class BagTable(Table, unknown="refuse"):
    """``[bag]``: the bags, and the rules of topics without their own."""

    clock: ClockKind
    files: Annotated[tuple[str, ...], Texts("names of bags")] = ()
    resample: Resampling = "previous"
    max_age_s: _Time = 0.1
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
    """The tables that mapping files of all sources have."""

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

    def rules(self, topic: str) -> TopicRules:
        """Return the clock and resampling of a topic: its own, else those of ``[bag]``."""
        own, bag = self.topics.get(topic, TopicTable()), self.bag
        age = bag.max_age_s if own.max_age_s is None else own.max_age_s
        return TopicRules(own.clock or bag.clock, own.resample or bag.resample, age, own.lag_s)
