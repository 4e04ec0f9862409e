"""The content of a mapping file as frozen objects: files, meaning of columns, rules of cutting."""

from __future__ import annotations

from collections.abc import Mapping as Map
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from skincal.dataset import DatasetMeta, TaxelPositions
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


@dataclass(frozen=True)
class CutRules:
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
    on_n: float = 0.2
    off_n: float = 0.1
    band: float = 0.1
    settle_s: float = 0.0
    min_hold_s: float = 0.1
    slope_n_per_s: float = 0.1
    window_s: float = 0.2
    start_at_zero: bool = True
    own_clocks: bool = False
    gap_s: float = 1.0
    slides: Slides = "cut"
    still_m: float | None = None


@dataclass(frozen=True)
class JoinedFile:
    """A further file with its own clock: a force gauge, a position log.

    Attributes:
        name: name of its table in ``[files]``.
        place: place of that table in the mapping.
        file: its name, or a pattern of names; relative to the mapping.
        form: its layout.
        time: its stamps; None with a fixed rate.
        resample: method of resampling at the times of the taxels.
        max_age_s: validity of a value [s]; None: three of its own steps.
        offset_s: offset from its clock to that of the taxels [s]; None: found by correlation.
        within_s: largest offset that is searched then [s].
    """

    name: str
    place: str
    file: str
    form: CsvFormat
    time: Quantity | None
    resample: Resampling = "linear"
    max_age_s: float | None = None
    offset_s: float | None = 0.0
    within_s: float = np.inf


@dataclass(frozen=True)
class CsvFormat:
    """Layout of text files.

    Attributes:
        rows: meaning of a row.
        files: names of the files with the taxels, relative to the mapping.
        layout: a table, blocks of rows (one per frame), or lines of ``name=value``.
        block_rows: rows of a block; 0: up to the next line that is not a row.
        rate_hz: rows per second, for files without stamps [Hz]; None: a column holds the time.
        order: order of events: that of the rows, or that of the stamps.
        joined: other files, by their names in ``[files]``.
    """

    rows: Rows
    files: tuple[str, ...] = ()
    layout: Layout = "table"
    block_rows: int = 0
    rate_hz: float | None = None
    order: Order = "file"
    joined: tuple[JoinedFile, ...] = ()
    delimiter: str = ","
    decimal: str = "."
    encoding: str = "utf-8"
    comment: str = ""
    skip_rows: int = 0
    skip_after_header: int = 0
    header: bool = True
    missing: tuple[str, ...] = ("", "NaN", "nan", "NA")
    drop_incomplete: bool = False


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
        positions: positions of taxels that form no grid.
        meshes: content of mesh files by name.
    """

    path: Path
    meta: DatasetMeta
    quantities: tuple[Quantity, ...]
    taxels: Taxels
    placement: Placement
    cut: CutRules
    source: CsvFormat | BagFormat
    positions: TaxelPositions | None = None
    meshes: Map[str, bytes] = field(default_factory=dict[str, bytes])

    @property
    def rows(self) -> Rows:
        """Meaning of a row of the source."""
        return self.source.rows if isinstance(self.source, CsvFormat) else "series"

    def quantity(self, target: str) -> Quantity | None:
        """Return the source of a column; None if it is not mapped."""
        return next((q for q in self.quantities if q.target == target), None)
