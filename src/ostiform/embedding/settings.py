"""How a component is embedded."""

from dataclasses import dataclass
from typing import Literal

from ostiform.embedding.energy import EnergyWeights
from ostiform.errors import InputError

Method = Literal["barrier", "harmonic-barrier", "harmonic"]
METHODS: tuple[Method, ...] = ("barrier", "harmonic-barrier", "harmonic")


@dataclass(frozen=True, slots=True)
class EmbeddingSettings:
    """The method of embedding and where it stops.

    Attributes
    ----------
    method : str
        ``"barrier"``: MIPS and area, cannot fold (the default). ``"harmonic-barrier"``: HY's
        Dirichlet energy with a fifth of that barrier, cannot fold. ``"harmonic"``: HY 2.2, folded
        wherever a circle is wider than about twice its conformal radius.
    tolerance : float
        A minimisation stops when a Newton step promises a smaller relative decrease than this.
    max_iterations : int
        Newton steps of the exact barrier, at most.
    """

    method: Method = "barrier"
    tolerance: float = 1e-4
    max_iterations: int = 60

    def __post_init__(self) -> None:
        """Check the values."""
        if self.method not in METHODS:
            raise InputError(
                f"embedding method: expected one of {', '.join(METHODS)}, found {self.method!r}"
            )
        if not 0.0 < self.tolerance < 1.0:
            raise InputError(
                f"embedding tolerance: expected a number between 0 and 1, found {self.tolerance}"
            )
        if self.max_iterations < 1:
            raise InputError(
                f"embedding max_iterations: expected at least 1, found {self.max_iterations}"
            )

    @property
    def weights(self) -> EnergyWeights:
        """The weights of the barrier energy."""
        if self.method == "harmonic-barrier":
            return EnergyWeights(1.0, 0.2, 0.2)
        return EnergyWeights(0.0, 1.0, 1.0)
