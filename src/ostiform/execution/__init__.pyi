from .cluster import ClusterWorkers as ClusterWorkers
from .outcome import Executor as Executor
from .outcome import Outcome as Outcome
from .processes import Workers as Workers
