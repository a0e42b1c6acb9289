"""RoboOS: one master plans whole tasks and sends subtasks to robots, which recover by a local checklist.

Source: github.com/FlagOpen/RoboOS at 35d6fe7 (its files were read in the fork xiaow190/RoboOS, 32f6c1a), and its store,
`communication.py` of flag_scale. Paper: tab:baseline_context.

There is no policy, trust or supervisor check anywhere in the source, so a declared rule reaches nothing here and
violations are structural; the dial `gate` adds a check of the robot's own policy. A record names the robot and the
task, never a requester or a supervisor (slaver/run.py, _send_result).
"""

from fsar_ledger.runtime.architectures import COMMON, HandlerTable
from fsar_ledger.runtime.handlers import assistance

from . import master, robot

ROBOOS: HandlerTable = HandlerTable.of(
    *COMMON,
    assistance,
    master,
    robot,
    own=robot.OWN,
    instead=master.INSTEAD,
)
