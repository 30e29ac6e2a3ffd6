"""Signals that end commands."""

import signal


def end_as_by_ctrl_c() -> None:
    """Let SIGTERM and a terminal that closes interrupt the main thread, so that it cleans up.

    What is ignored (under nohup) or handled already stays so.
    """
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)
