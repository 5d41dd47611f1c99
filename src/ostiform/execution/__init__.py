"""One function over many items: in this process, in several, or on a cluster."""

from ostiform.execution.cluster import ClusterWorkers
from ostiform.execution.outcome import Executor, Outcome
from ostiform.execution.processes import Workers

__all__ = ["ClusterWorkers", "Executor", "Outcome", "Workers"]
