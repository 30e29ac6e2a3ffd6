"""The kinds of stages, and the version that each has in this program."""

from adr_service.stages.base import AnyStage
from adr_service.stages.criticise import Criticise
from adr_service.stages.evaluate import Evaluate
from adr_service.stages.infer import Infer
from adr_service.stages.propose import Propose
from adr_service.stages.smooth_states import SmoothStates
from adr_service.stages.target_episode import TargetEpisode
from adr_service.stages.target_return import TargetReturn
from adr_service.stages.target_rollout import TargetRollout
from adr_service.stages.train_policy import TrainPolicy

_ALL: tuple[type[AnyStage], ...] = (
    *(Criticise, Evaluate, Infer, Propose, SmoothStates),
    *(TargetEpisode, TargetReturn, TargetRollout, TrainPolicy),
)
VERSIONS = {stage.kind: stage.version for stage in _ALL}
