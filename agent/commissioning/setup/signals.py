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
    number = "several signals are" if same else "no signal is"
    place = f"{what} " if what.startswith("--") else "--channel ...:UNIT:"
    advice = f"name one of {', '.join(same or signals[:20])}, as {place}MESSAGE.SIGNAL"
    raise UsageError.at("--dbc", f'{what}: {number} called "{wanted}"', advice)
