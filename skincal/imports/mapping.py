"""The content of a mapping file as frozen objects: files, meaning of columns, rules of cutting."""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Mapping as Map
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from skincal.dataset import DatasetMeta, TaxelPositions
from skincal.dataset.keys import Key, Texts
from skincal.dataset.schema import Table
from skincal.dataset.schema_errors import Violation
from skincal.dataset.word_checks import as_word, swapped
from skincal.imports.units import Unit

FORMAT = "skincal-import/1"

Rows = Literal["presses", "series"]
By = Literal["force", "taxels", "plateaus", "press"]
ClockKind = Literal["header", "receive"]
Resampling = Literal["previous", "linear"]
Layout = Literal["table", "blocks", "labelled"]
Order = Literal["file", "time"]
Slides = Literal["cut", "keep", "refuse"]
Count = Annotated[int, Key("a whole number, 0 or more", 0)]


@dataclass(frozen=True)
class Quantity:
    """Source of one column of the dataset.

    A number is ``scale * x + offset`` in ``unit``, then converted to SI.

    Attributes:
        target: column of the dataset.
        place: place of this entry in the mapping, for errors.
        sources: names of source columns, or field paths in a message; several: the length of that vector.
        topic: the topic of a bag, or the table of ``[files]``; '' for the file of the taxels and for a constant.
        constant: constant value instead of a source, in SI if it is a number; None if it is measured.
        unit: unit of the source.
        scale: factor, with its sign.
        offset: added after the factor.
        words: meaning of words of the source; others are kept.
        wraps_at: period of the counter behind a time, in the source's numbers; None: found from the steps back.
        format: format of dates for ``strptime``; '' for ISO 8601.
        parts: of a time in several columns, which are added up (seconds and nanoseconds, a date and a time of day),
            the factor of each; empty: one column.
    """

    target: str
    place: str
    sources: tuple[str, ...] = ()
    topic: str = ""
    constant: float | str | None = None
    unit: Unit = field(default_factory=lambda: Unit("1"))
    scale: float = 1.0
    offset: float = 0.0
    words: Map[str, str] = field(default_factory=dict[str, str])
    wraps_at: float | None = None
    format: str = ""
    parts: tuple[float, ...] = ()

    def si(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return numbers of the source in SI, of the same shape."""
        # A factor of one and a zero offset leave every bit unchanged.
        return (self.scale * values + self.offset) * self.unit.factor + self.unit.offset


@dataclass(frozen=True)
class Taxels:
    """Source of the image.

    Attributes:
        place: place of this table in the mapping.
        names: columns of the source in its own flat order; empty for a bag.
        topic: the topic of a bag; '' for a CSV file.
        field: path of the array in a message.
        order: for each of our taxels, in our flat order, its index in the source; shape (J,).
        scale: factor on the source's values.
        offset: added after the factor [counts].
        falling_from: reading without load of a sensor whose values fall with load; None: they grow.
        axes: source columns of a taxel, side by side in ``names``; its value is the length of their change from rest.
        word: ``uint16``, ``int16``, …: word type as which readings are interpreted; '' for no change.
        swap_bytes: whether to exchange the two bytes of each reading.
        rest_rows: with several axes, number of rows at rest at the start of a file.
    """

    place: str
    names: tuple[str, ...]
    topic: str
    field: str
    order: tuple[int, ...]
    scale: float = 1.0
    offset: float = 0.0
    falling_from: float | None = None
    word: str = ""
    swap_bytes: bool = False
    axes: int = 1
    rest_rows: int = 0

    def counts(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return images of the source, (rows, source columns), as counts that grow with load, (rows, J)."""
        if self.swap_bytes:
            values = swapped(values)
        if self.word:
            values = as_word(values, self.word)
        if self.axes > 1:
            vectors = values.reshape(len(values), -1, self.axes)
            values = np.linalg.norm(vectors - np.nanmedian(vectors[: self.rest_rows], axis=0), axis=2)
        counts = self.scale * values[:, list(self.order)] + self.offset
        return counts if self.falling_from is None else self.falling_from - counts


@dataclass(frozen=True)
class Placement:
    """Transformation of points of the source to the fingertip frame: ``p = R x + t``.

    Attributes:
        rotation: R, rows.
        translation_m: t [m].
        project: whether to move points to the nearest point of the surface.
    """

    rotation: tuple[tuple[float, float, float], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    project: bool = False

    @property
    def moves(self) -> bool:
        """True if it changes anything except by projection."""
        return self != Placement(project=self.project)


_Time = Annotated[float, Key("a time [s], 0 or more", 0.0)]


@dataclass(frozen=True)
class CutRules(Table, unknown="refuse"):
    """Rules for cutting a time series into presses.

    Attributes:
        by: what a press is: a contact by force or by taxels, a plateau, or a number in a column.
        on_n: a contact is a stretch above ``off_n`` that rises above this force [N].
        off_n: see ``on_n`` [N].
        band: half width of the hold, relative to the force that is kept longest.
        settle_s: time at the start of a hold that still counts as loading [s].
        min_hold_s: a press with a shorter hold is left out [s].
        slope_n_per_s: largest change of force on a plateau [N/s].
        window_s: window of that slope [s].
        start_at_zero: whether the session clock begins at the first sample.
        own_clocks: whether each file has its own clock; then files follow each other.
        gap_s: gap between such files [s].
        slides: treatment of a contact that slides in its hold: the hold is cut to where the contact rests, or it is
            kept, or the import refuses.
        still_m: largest motion of a contact that rests [m]; None: sigma_m of the positions.
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
    slides: Slides = "cut"
    still_m: Annotated[float | None, Key("a length [m], 0 or more", 0.0)] = None

    def violations(self) -> Iterator[Violation]:
        """Yield a band in percent."""
        if self.band >= 0.5:
            yield "band", "a share below 0.5", self.band, "It looks like percent; divide by 100."


@dataclass(frozen=True, kw_only=True)
class CsvFormat(Table, unknown="refuse"):
    """Layout of a text file.

    Attributes:
        layout: a table, blocks of rows (one per frame), or lines of ``name=value``.
        block_rows: rows of a block; 0: up to the next line that is not a row.
        rate_hz: rows per second, for files without stamps [Hz]; None: a column holds the time.
        order: order of events: that of the rows, or that of the stamps.
        missing: texts that mean no value, beside an empty cell.
    """

    delimiter: str = ","
    decimal: Literal[".", ","] = "."
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
        if self.delimiter == self.decimal:
            yield "decimal", "another character than the delimiter", f'"{self.decimal}"'
        try:
            "".encode(self.encoding)  # refuses codecs that are not of text like unknown ones
        except (LookupError, ValueError):
            yield "encoding", "an encoding like utf-8, utf-16 or latin-1", f'"{self.encoding}"'


@dataclass(frozen=True, kw_only=True)
class CsvSource(CsvFormat):
    """The text files with the taxels.

    Attributes:
        rows: meaning of a row.
        files: their names, relative to the mapping.
        drop_incomplete: whether rows without force or position are left out, instead of refused.
    """

    rows: Rows
    files: Annotated[tuple[str, ...], Texts("names of files")] = ()
    drop_incomplete: bool = False


@dataclass(frozen=True, kw_only=True)
class Entry(Table, unknown="refuse"):
    """An entry of ``[columns]``: the source of a column, or a constant."""

    wanted = 'a table like { column = "Fz", unit = "mN" }, or for SI the name of a column'

    value: Annotated[
        float | str | tuple[float, float, float] | None, Key("a number, three numbers, or a text")
    ] = None
    unit: Annotated[str | tuple[str, ...] | None, Key("the name of a unit")] = None
    sign: Annotated[float, Key("1 or -1", -1, 1)] = 1
    scale: float = 1.0
    offset: float = 0.0
    words: Annotated[Map[str, str], Key('a table like { loading = "up" }')] = field(
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
    fields: Annotated[tuple[str, ...], Texts("a list of names")] = ()
    field: str | None = None

    @property
    def source(self) -> tuple[str, str | None, Named]:
        """Topic, and the field or fields of its messages."""
        return self.topic, self.field, self.fields


@dataclass(frozen=True, kw_only=True)
class JoinedFormat(CsvFormat):
    """A table of ``[files]``: a further file with its own clock.

    Attributes:
        file: its name, or a pattern of names; relative to the mapping.
        time: its stamps; None with a fixed rate.
        resample: method of resampling at the times of the taxels.
        max_age_s: validity of a value [s]; None: three of its own steps.
        offset_s: offset from its clock to that of the taxels [s], or that it is found by correlation.
        within_s: largest offset that is searched then [s].
    """

    file: Annotated[str, Key("the name of the file, or a pattern like gauge_*.csv")]
    time: CsvEntry | None = None
    resample: Resampling = "linear"
    max_age_s: _Time | None = None
    offset_s: Annotated[float | Literal["estimate"], Key('a time [s], or "estimate"')] = 0.0
    within_s: _Time = np.inf

    def violations(self) -> Iterator[Violation]:
        """Yield a file without stamps."""
        yield from super().violations()
        if self.time is None and self.rate_hz is None:
            yield "time", 'its stamps, like { column = "t", unit = "s" }', "nothing", "Add time, or rate_hz."


@dataclass(frozen=True)
class JoinedFile:
    """A further file with its own clock: a force gauge, a position log.

    Attributes:
        name: name of its table in ``[files]``.
        place: place of that table in the mapping.
        form: the table.
        time: its stamps; None with a fixed rate.
    """

    name: str
    place: str
    form: JoinedFormat
    time: Quantity | None


@dataclass(frozen=True)
class TopicRules:
    """Clock and resampling of one topic; its stamps are ``lag_s`` too late."""

    clock: ClockKind
    resample: Resampling = "previous"
    max_age_s: float = 0.1
    lag_s: float = 0.0


@dataclass(frozen=True)
class BagFormat:
    """Reading options of bags.

    Attributes:
        default: clock and resampling of topics without their own rules.
        files: bags, relative to the mapping.
        topics: rules of single topics.
        definitions: files of message types that the bag does not define.
        joints_topic: topic of ``sensor_msgs/JointState``; '' for none.
        joints: names of the joints in the order of ``q_0``, ``q_1``...
    """

    default: TopicRules
    files: tuple[str, ...] = ()
    topics: Map[str, TopicRules] = field(default_factory=dict[str, TopicRules])
    definitions: Map[str, str] = field(default_factory=dict[str, str])
    joints_topic: str = ""
    joints: tuple[str, ...] = ()

    def rules(self, topic: str) -> TopicRules:
        """Return the clock and resampling of a topic."""
        return self.topics.get(topic, self.default)


@dataclass(frozen=True)
class Mapping:
    """The content of a mapping file.

    Attributes:
        path: the file; paths in it are relative to its folder.
        meta: content of ``dataset.toml``.
        quantities: one per column of the dataset.
        taxels: the image.
        placement: transformation of positions.
        cut: rules for cutting time series.
        source: options of the recording, text files or bags.
        joined: other files, in the order of ``[files]``.
        positions: positions of taxels that form no grid.
        meshes: content of mesh files by name.
    """

    path: Path
    meta: DatasetMeta
    quantities: tuple[Quantity, ...]
    taxels: Taxels
    placement: Placement
    cut: CutRules
    source: CsvSource | BagFormat
    joined: tuple[JoinedFile, ...] = ()
    positions: TaxelPositions | None = None
    meshes: Map[str, bytes] = field(default_factory=dict[str, bytes])

    @property
    def rows(self) -> Rows:
        """Meaning of a row of the source."""
        return self.source.rows if isinstance(self.source, CsvSource) else "series"

    def quantity(self, target: str) -> Quantity | None:
        """Return the source of a column; None if it is not mapped."""
        return next((q for q in self.quantities if q.target == target), None)
