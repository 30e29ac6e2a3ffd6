"""Criticism: what a simulator gets wrong, given measured data (docs/criticism.md: how to use it).

Read in this order: `measurements` (the data) and `nominal` (the model); `simulator` (predictions
one control step ahead) and `readings` (what sensors show of them); `layout` and `linearisation`
(residuals by episode, and how they would change); `noise`, `variances` and `linear` (their
likelihood); `fits` and `probable_states`; `evidence` (what fits gain); `responses` and `scan`
(every possible effect, linearised); `identifiability` (what the data cannot tell apart); `inverse`
(many effects at once, by the forces that the motion needs); `decision`, `weighing`, `revision` and
`naming` (which effects are causes, one by one and in the light of each other); `flexible_force` and
`sensor_spread` (causes that no effect moves on average); `gain` (worth on sealed episodes);
`summary`, `verdict`, `extension`, `experiments`, `remarks`, `report`, `figures` (the answer);
`pipeline` runs it all, and `next_recording` plans what to measure next; `excitation` says what data
could show before anything is fitted.

Letters in shapes: `rows` measured rows, `N` transitions, `E` episodes, `T` the most transitions of
an episode, `m` = 2 nv measured numbers of a row, `d` free parameters, `p` fitted columns.
"""
