"""What a mapping file says, as frozen objects: where a recording lies, what its columns mean, how it is cut."""

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
    """Where one column of the dataset comes from.

    A number is ``scale * x + offset`` in ``unit``, turned into SI after that.

    Attributes:
        target: the dataset's column.
        place: of this entry in the mapping, for errors.
        sources: names of source columns, or field paths in a message; several: the length of that vector.
        topic: the topic of a bag, or the table of ``[files]``; '' for the file of the taxels and for a constant.
        constant: in the place of a source, in SI where it is a number; None where it is measured.
        unit: of the source.
        scale: factor, with its sign.
        offset: what is added after the factor.
        words: what words of the source stand for; others are kept.
        wraps_at: what the counter behind a time counts to, in the source's numbers; None: found from the steps back.
        format: how dates are written, as ``strptime`` takes it; '' for ISO 8601.
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

    def si(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the numbers of the source in SI, of the same shape."""
        # A factor of one and an offset of nothing leave every bit as it was.
        return (self.scale * values + self.offset) * self.unit.factor + self.unit.offset


@dataclass(frozen=True)
class Taxels:
    """Where the image comes from.

    Attributes:
        place: of this table in the mapping.
        names: columns of the source in its own flat order; empty for a bag.
        topic: the topic of a bag; '' for a CSV file.
        field: path of the array in a message.
        order: for each of our taxels, in our flat order, its index in the source; shape (J,).
        scale: factor on the source's values.
        offset: what is added after the factor [counts].
        falling_from: what a sensor whose values fall with load is taken from; None: they grow.
        axes: source columns of a taxel, side by side in ``names``; its value is the length of their change from rest.
        word: ``uint16``, ``int16``, …: how readings of so many bits are to be taken; '' for as they are.
        swap_bytes: whether the two bytes of each reading are exchanged.
        rest_rows: with several axes, so many rows at the start of a file are at rest.
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
        """Return the images of the source, shape (rows, columns of the source), as counts that grow with load, (rows, J)."""
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
    """How points of the source become points of the fingertip frame: ``p = R x + t``.

    Attributes:
        rotation: R, rows.
        translation_m: t [m].
        project: whether points are moved to the nearest point of the surface.
    """

    rotation: tuple[tuple[float, float, float], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    project: bool = False

    @property
    def moves(self) -> bool:
        """Whether it changes anything but by projection."""
        return self != Placement(project=self.project)


@dataclass(frozen=True)
class CutRules:
    """How a time series becomes presses.

    Attributes:
        by: a contact is a press, by its force or by the taxels, a plateau is one, or a column numbers them.
        on_n: a contact is a stretch above ``off_n`` that rises above this force [N].
        off_n: see ``on_n`` [N].
        band: half the width of the hold, as a share of the force that is kept longest.
        settle_s: how much of the start of a hold still counts as loading [s].
        min_hold_s: a press with a shorter hold is left out [s].
        slope_n_per_s: force changes less on a plateau [N/s].
        window_s: over which that slope is taken [s].
        start_at_zero: whether the session clock begins at the first sample.
        own_clocks: whether each file has a clock of its own; then files follow each other.
        gap_s: between such files [s].
        slides: what becomes of a contact that slides in its hold: the hold is cut to where the contact rests, it is
            kept, or the import refuses.
        still_m: how far a contact that rests moves at most [m]; None: sigma_m of the positions.
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
    """A file beside that of the taxels, with a clock of its own: a force gauge, a position log.

    Attributes:
        name: of its table in ``[files]``.
        place: of that table in the mapping.
        file: its name, or a pattern of names; relative to the mapping.
        form: its layout.
        time: its stamps; None where it has a rate.
        resample: how its values come to the times of the taxels.
        max_age_s: a value counts for so long [s]; None: three of its own steps.
        offset_s: what is added to its times to be on the clock of the taxels [s]; None: found by correlation.
        within_s: only offsets up to this are looked at then [s].
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
    """How text files are laid out.

    Attributes:
        rows: what a row is.
        files: names of the files with the taxels, relative to the mapping.
        layout: a table, blocks of rows that are a frame each, or lines of ``name=value``.
        block_rows: rows of a block; 0: up to the next line that is no row.
        rate_hz: rows a second, for files without stamps [Hz]; None: a column says the time.
        order: of events: that of the rows, or that of the stamps.
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
    """How bags are read.

    Attributes:
        default: clock and resampling of topics that have no rules of their own.
        files: bags, relative to the mapping.
        topics: rules of single topics.
        definitions: message types that the bag does not define, with their files.
        joints_topic: of ``sensor_msgs/JointState``; '' for none.
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
    """All of a mapping file.

    Attributes:
        path: the file; what it names is looked for beside it.
        meta: what becomes ``dataset.toml``.
        quantities: one a column of the dataset.
        taxels: the image.
        placement: of positions.
        cut: of time series.
        source: of the recording, text files or bags.
        positions: of taxels that form no grid.
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
        """What a row of the source is."""
        return self.source.rows if isinstance(self.source, CsvFormat) else "series"

    def quantity(self, target: str) -> Quantity | None:
        """Where a column comes from; None where it is not mapped."""
        return next((q for q in self.quantities if q.target == target), None)
