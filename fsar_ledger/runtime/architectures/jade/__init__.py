"""JADE: agents that find each other in yellow pages and award work by the FIPA contract net.

Sources: JADE 4.6.5 (`src/jade/...`, as named in each module) and the FIPA standards SC00029H (contract net) and
SC00030H (iterated contract net). What they leave open is a dial (`designs.dials.Jade`) or a choice of ours, said where
it is made. JADE says nothing of robots: one agent for each robot is the plainest reading, four are DHMA's choice.
Paper: tab:baseline_context.
"""

from fsar_ledger.runtime.architectures.handler_table import COMMON, HandlerTable

from . import contract_net, directory, execution

JADE: HandlerTable = HandlerTable.of(*COMMON, directory, contract_net, execution, own=execution.OWN)
