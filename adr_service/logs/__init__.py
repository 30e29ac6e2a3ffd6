"""Logs of robots, in their makers' formats, as measurements that a criticism accepts.

    logs = read_logs(Path("run1.csv"))
    converted = convert(logs, LogMap.from_toml(text), model)
    converted.measurement               # times, states and commands in SI units, in episodes
    converted.records                   # what was read, how it was resampled, what was left out

`base` has the columns of a log, and one file for each format reads them. `mapping` says which of
them is which joint or command. `tracks` has these in the units of a model, `resampling` at other
times, and `conversion` cuts them into episodes. `report` is a page of all that, and of what
the data could show.
"""
