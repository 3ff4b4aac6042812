"""The signals of a DBC file, and which of them a channel means."""

from pathlib import Path

from agent.errors import UsageError


def dbc_signals(file: Path) -> list[str]:
    """Return every signal of a DBC file as "message.signal". Raises UsageError."""
    import cantools

    try:
        database = cantools.database.load_file(file)
    except (OSError, ValueError, cantools.Error) as error:
        words = " ".join(str(error).split())
        advice = "name a DBC file; it may lie beside FILE"
        raise UsageError.at("--dbc", f"{file} cannot be read: {words}", advice) from error
    messages = getattr(database, "messages", [])
    return [f"{message.name}.{signal.name}" for message in messages for signal in message.signals]


def placed(wanted: str, signals: list[str], what: str) -> str:
    """Return the signal called so, its message left out or not, whatever the case. Raises UsageError."""
    same = [
        signal
        for signal in signals
        if wanted.casefold() in (signal.casefold(), signal.split(".")[1].casefold())
    ]
    if len(same) == 1:
        return same[0]
    words = (
        f'{what}: several signals are called "{wanted}"'
        if same
        else f'{what}: no signal is called "{wanted}"'
    )
    raise UsageError.at(
        "--dbc", words, f"name one of {', '.join(signals[:20])}, as --channel ...:UNIT:MESSAGE.SIGNAL"
    )
