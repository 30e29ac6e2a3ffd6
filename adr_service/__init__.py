"""Adaptive domain randomization: tasks, methods, and the benchmark protocol.

from adr_service.programs import run
from adr_service.specs import RunSpec
from adr_service.stages.local import LocalStages

spec = RunSpec.model_validate({"task": "arm", "method": "simopt", "preset": "smoke"})
for event in run(spec, LocalStages()):
    print(event.key)
"""

__version__ = "0.1.0"

from adr_service.tasks.gymnasium_ids import register_with_gymnasium

register_with_gymnasium()
