"""How a component is embedded."""

from typing import Annotated

from ostiform.embedding.energy import EnergyWeights
from ostiform.study import EmbeddingMethod, StatedEmbedding
from ostiform.values import Above, AtLeast, value


@value(eq=True)
class EmbeddingSettings:
    """The method of embedding, by default what a study has, and where it stops.

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

    method: EmbeddingMethod = StatedEmbedding().method
    tolerance: Annotated[float, Above(0)] = 1e-4
    max_iterations: Annotated[int, AtLeast(1)] = 60

    @property
    def weights(self) -> EnergyWeights:
        """The weights of the barrier energy."""
        if self.method == "harmonic-barrier":
            return EnergyWeights(1.0, 0.2, 0.2)
        return EnergyWeights(0.0, 1.0, 1.0)
