"""ALLIANCE: each robot alone decides what it does, by motivations that grow from impatience and end in acquiescence.

Nobody asks, allows, assigns or supervises: there is no request, no registry, no central store and no human level. A
robot takes up what it senses as wanted and does not hear a teammate at, and says what it is at; a teammate that hears
nothing more, or has been patient for long enough, takes over.

Sources: the abstract of L. E. Parker, "ALLIANCE: an architecture for fault tolerant multirobot cooperation", IEEE T-RA
14(2), 1998 (vdocument.in, TRA.pdf); for the formulas, the package `alliance` of adrianohrl/ruler, folder
mrta_archs/alliance/src/alliance: motivational_behaviour.cpp, activity_suppression.cpp and inter_communication.cpp at
07d0c1c, impatience.cpp and impatience_reset.cpp at 0a73f2f, acquiescence.cpp at 3423946, sensory_feedback.cpp at
452f077. What they leave open are the dials of `designs.dials.Alliance`. That the slow rate reaches the threshold after
the patience with a teammate, and L-ALLIANCE's mean and deviation, are from memory of Parker's report.

Records name the robot that executes. They name no requester, since none asks, and no supervisor, since none is found in
either source. A rule of the fleet is violated, since nothing looks at one; a robot's own policy reaches it as sensory
feedback (dial `senses_policy`), and a review is put before nobody, so it is as a denial.

Left out: rates of single tasks, and of single robots where the dial `stagger_us` is 0 (teammates that sense a need
within a message's time of each other then all start), the spin of 2 Hz (motivation is linear between two events, so its
instant is computed), loss of messages, and the sensing of a teammate's effects other than by its messages.
"""

from fsar_ledger.runtime.architectures.handler_table import COMMON, HandlerTable

from . import activity, execution, motivation

ALLIANCE: HandlerTable = HandlerTable.of(
    *COMMON,
    motivation,
    activity,
    execution,
    own=execution.OWN,
    instead=execution.INSTEAD,
)
