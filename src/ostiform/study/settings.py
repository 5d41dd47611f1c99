"""The settings of a study: what ``study.toml`` may say, checked."""

from typing import Annotated, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field

from ostiform.surface import Seam

Finite: TypeAlias = Annotated[float, Field(allow_inf_nan=False)]
Point: TypeAlias = tuple[Finite, Finite, Finite]
Name: TypeAlias = Annotated[str, Field(min_length=1, pattern=r"^[^\s./\\{}=+][^./\\{}=+]*$")]
"""Part and ostium names; ``.``, ``+`` and ``=`` join names, ``/`` would be a group in HDF5."""

EmbeddingMethod: TypeAlias = Literal["barrier", "harmonic-barrier", "harmonic"]
Optimiser: TypeAlias = Literal["majorise", "conjugate-gradient"]
AlignmentMode: TypeAlias = Literal["rigid", "similarity", "none"]


class _Settings(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class PartSettings(_Settings):
    """One part: the names of its openings (none for a closed surface), and which are cuts.

    `cuts` are openings of tubes that end wherever somebody cut them (veins, a vessel's end).
    """

    ostia: tuple[Name, ...] = ()
    cuts: tuple[Name, ...] = ()


class SeamSettings(_Settings):
    """Two ostia that are one curve, written ``"PART.OSTIUM"``."""

    first: str
    second: str


class CircleSettings(_Settings):
    """A circle of the base domain given by hand.

    `frame` says on which sphere: the component sphere, or the sphere of the ostium's part alone
    (HY 2.1), whose north pole is the seam.
    """

    center: Point
    radius_deg: Annotated[float, Field(gt=0.0, lt=180.0)]
    phase_deg: Finite = 0.0
    frame: Literal["component", "part"] = "component"


class DomainSettings(_Settings):
    """The base domain: circles by full ostium name; those not given are laid out."""

    circles: dict[str, CircleSettings] = {}


class ShapesSettings(_Settings):
    """Where the shapes come from.

    Exactly one of `pattern` (named fields ``{subject}``, ``{phase}``, ``{part}``; ``*`` matches
    anything; ``/`` steps into folders) and `sheet` (a CSV or XLSX file) is given. File names are
    relative to `folder`, which is relative to the study file's folder. `open` makes openings by
    deleting cells: ``array`` is the name of a cell or point array, every other key an ostium and
    its value. `split` makes parts of one mesh: ``array`` likewise, every other key a part and its
    value or values; `joined` says that one mesh without labels holds all parts, to be divided by
    the cuts at the seams. `times` gives phases as fractions of the cycle. `reflect` names the
    subjects that are mirrored on reading (left for right), ``*`` matches anything.
    """

    pattern: str | None = None
    sheet: str | None = None
    folder: str = "."
    on_error: Literal["skip", "stop"] = "skip"
    open: dict[str, str | int | float] = {}
    split: dict[str, str | int | tuple[int, ...]] = {}
    joined: bool = False
    times: dict[str, Annotated[float, Field(ge=0.0, lt=1.0)]] = {}
    reflect: str | tuple[str, ...] = ()


class CycleSettings(_Settings):
    """The cycle that the phases belong to.

    `length_s` is its length where the sheet gives times in seconds (``time_s``) and no length of
    their own. `landmarks` are events such as the end of systole, as fractions of the cycle, by
    subject: with them, the subjects' times are warped so that the events fall together.
    """

    length_s: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None = None
    landmarks: dict[str, tuple[Annotated[float, Field(gt=0.0, lt=1.0)], ...]] = {}


class OstiaSettings(_Settings):
    """Rough positions of ostia, in the units and frame of the files.

    `points` holds for every shape; `shapes` for one shape (``"SUBJECT/PHASE"``) or all shapes of
    a subject (``"SUBJECT"``), where it comes first. `close` names openings (``"PART.NAME"``)
    beyond the ostia of a part that some shapes have and that are closed there. `trust` says what
    counts where the names given to a shape contradict the geometry of the others; without it such a
    shape is left out. `shared` names pairs of openings of two parts whose rims are one curve that
    no seam joins, as those of endo- and epicardium at a valve.
    """

    points: dict[str, Point] = {}
    shapes: dict[str, dict[str, Point]] = {}
    close: tuple[str, ...] = ()
    trust: Literal["names", "geometry"] | None = None
    shared: tuple[tuple[str, str], ...] = ()


class WeldingSettings(_Settings):
    """How far apart the two rims of a seam may be: default a quarter of their median edge."""

    tolerance_mm: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None = None


class LabelOpening(_Settings):
    """What a part opens into: a label, and the names of as many openings as it makes contacts."""

    label: int | str | tuple[int | str, ...]
    ostia: tuple[Name, ...] = ()

    @property
    def labels(self) -> tuple[int | str, ...]:
        """The label or labels."""
        return (self.label,) if isinstance(self.label, int | str) else self.label


class LabelsSettings(_Settings):
    """How label maps become surfaces.

    `values` gives each part its label or labels, as numbers or as names of 3D Slicer's segments; a
    part without takes every voxel other than 0 of its own file. `edge_mm` is the edge length of the
    surface, default 1.5 voxels. `openings` says where a part is open because it touches a label
    that is none of the component's parts: ``"PART.OSTIUM"``, or with `ostia` ``"PART.GROUP"`` for
    several contacts. Labels may leave a gap of `gap_mm`, contacts below `contact_mm2` are noise,
    and handles with a loop of up to `handles_mm` are mended, default 20 mm or four slices. `rim`
    says whether the rim of a contact is cut by a plane or is its smoothed curve; by default a plane
    where slices are thicker than 3 mm.
    """

    edge_mm: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None = None
    values: dict[str, int | str | tuple[int | str, ...]] = {}
    openings: dict[str, int | str | tuple[int | str, ...] | LabelOpening] = {}
    rim: Literal["plane", "curve"] | None = None
    gap_mm: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 3.0
    contact_mm2: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 20.0
    handles_mm: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] | None = None


class PlaneSettings(_Settings):
    """A plane that opens one tube, in the units and frame of the files.

    The tube's section must have its centre within `reach` of `center`, default 20 mm.
    """

    center: Point
    normal: Point
    reach: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None = None


class CutsSettings(_Settings):
    """Where closed surfaces are cut open.

    `markups` is the 3D Slicer Markups file of each shape, a name with ``{subject}`` and
    ``{phase}`` relative to the folder of the shapes; its planes and closed curves are named by
    the ostia, its points are rough points. `planes` hold for every shape, those of `shapes` for
    one shape (``"SUBJECT/PHASE"``) or all of a subject.
    """

    markups: str | None = None
    planes: dict[str, PlaneSettings] = {}
    shapes: dict[str, dict[str, PlaneSettings]] = {}


class FieldSettings(_Settings):
    """A quantity that the files hold on the surface: voltage, thickness, a region.

    `array` is the point or cell array of every file that holds it, the field's own name by
    default; `part` the only part that has it, where not all do. `kind` says whether its values
    are numbers or labels, and `missing` which of them stands for none. Where `required` is false,
    a file may lack it.
    """

    array: Annotated[str, Field(min_length=1)] | None = None
    units: str = ""
    kind: Literal["number", "label"] = "number"
    part: str | None = None
    missing: Finite | None = None
    required: bool = True


class StatedEmbedding(_Settings):
    """How a component is mapped to its sphere."""

    method: EmbeddingMethod = "barrier"
    coarsen: bool = True


class TemplateSettings(_Settings):
    """The number of points that every shape is resampled at, about."""

    points: Annotated[int, Field(ge=50)] = 2500


class StatedCorrespondence(_Settings):
    """How the shapes are put into correspondence.

    `noise_mm` is the standard deviation per coordinate below which variation is noise; default
    0.2 times the median input edge. `coherence` is how strongly shapes are held to differ from
    their mean by smooth motions, in units of one over its squared radius. `batch` is how many
    shapes move between two updates of the mean and of what is common to all; default all.
    """

    optimiser: Optimiser = "majorise"
    levels: Annotated[int, Field(ge=1, le=8)] = 4
    noise_mm: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None = None
    coherence: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 1e6
    batch: Annotated[int, Field(ge=2)] | None = None
    seed: Annotated[int, Field(ge=0)] = 0


class LandmarksSettings(_Settings):
    """Landmarks of the user, which the correspondence respects as well as they are known.

    `file` holds the landmarks of each shape (scalismo's JSON), a name with ``{subject}`` and
    ``{phase}`` relative to the folder of the shapes; shapes without one have none. `sd_mm` is
    the standard deviation of each coordinate where the file states no uncertainty.
    """

    file: str | None = None
    sd_mm: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] = 2.0


class AlignmentSettings(_Settings):
    """How poses are removed; `per` defaults to subject where a subject has several phases."""

    mode: AlignmentMode = "rigid"
    per: Literal["subject", "shape"] | None = None
    frame: Literal["found", "files"] = "found"


class EvaluationSettings(_Settings):
    """What is measured.

    `folds` is the most models that are built anew, each without some subjects, to measure what is
    left of these: 0 for none, by default one per subject or, of many, 10. `truth` is the file of
    the true correspondence of a generated population, relative to the study file. `collapse` says
    whether a run whose model has collapsed ends with an error, after everything is written, or
    with a warning.
    """

    modes: Annotated[int, Field(ge=1)] = 10
    folds: Annotated[int, Field(ge=0)] | None = None
    specificity_samples: Annotated[int, Field(ge=1)] = 1000
    truth: str | None = None
    collapse: Literal["stop", "warn"] = "stop"


class ReportSettings(_Settings):
    """What the report is called and what it draws.

    `title` defaults to the name of the study's folder. `part` and `shape` (``"SUBJECT/PHASE"``)
    choose whose map to the sphere is drawn step by step: by default the part with the most
    openings, of the first shape.
    """

    title: Annotated[str, Field(min_length=1)] | None = None
    part: str | None = None
    shape: str | None = None


class StudySettings(_Settings):
    """Everything that ``study.toml`` says.

    `seed` is that of everything random but the correspondence, which has its own. `repair` says
    whether flaws of the meshes are mended or refused.
    """

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    units: Literal["mm", "cm", "m", "um"] = "mm"
    frame: Literal["LPS", "RAS"] = "LPS"
    pole: str | None = None
    repair: bool = True
    seed: Annotated[int, Field(ge=0)] = 0
    parts: Annotated[dict[Name, PartSettings], Field(min_length=1)]
    seams: tuple[SeamSettings, ...] = ()
    shapes: ShapesSettings
    cycle: CycleSettings = CycleSettings()
    ostia: OstiaSettings = OstiaSettings()
    welding: WeldingSettings = WeldingSettings()
    labels: LabelsSettings = LabelsSettings()
    cuts: CutsSettings = CutsSettings()
    fields: dict[Name, FieldSettings] = {}
    domain: DomainSettings = DomainSettings()
    embedding: StatedEmbedding = StatedEmbedding()
    template: TemplateSettings = TemplateSettings()
    correspondence: StatedCorrespondence = StatedCorrespondence()
    landmarks: LandmarksSettings = LandmarksSettings()
    alignment: AlignmentSettings = AlignmentSettings()
    evaluation: EvaluationSettings = EvaluationSettings()
    report: ReportSettings = ReportSettings()

    @property
    def part_names(self) -> tuple[str, ...]:
        """The parts in study order."""
        return tuple(self.parts)

    @property
    def ostium_names(self) -> tuple[str, ...]:
        """All ostia by full name, in study order; a seam counts twice."""
        return tuple(f"{part}.{o}" for part, listed in self.parts.items() for o in listed.ostia)

    @property
    def cut_names(self) -> tuple[str, ...]:
        """The ostia that are cuts, by full name, in study order."""
        return tuple(f"{part}.{o}" for part, listed in self.parts.items() for o in listed.cuts)

    @property
    def seam_pairs(self) -> tuple[Seam, ...]:
        """The seams as values."""
        return tuple(Seam(seam.first, seam.second) for seam in self.seams)

    @property
    def shares_files(self) -> bool:
        """Whether one file holds all parts of a shape."""
        return self.shapes.joined or bool(self.shapes.split) or len(self.labels.values) > 1

    @property
    def caps(self) -> dict[str, float]:
        """The cap values of `ShapesSettings.open` by full ostium name."""
        return {
            full_name(name, self.parts): float(value)
            for name, value in self.shapes.open.items()
            if name != "array"
        }


def full_name(name: str, parts: dict[str, PartSettings]) -> str:
    """Return the full name of an ostium that may be written without its part."""
    owners = [part for part, listed in parts.items() if name in listed.ostia]
    return f"{owners[0]}.{name}" if len(owners) == 1 else name
