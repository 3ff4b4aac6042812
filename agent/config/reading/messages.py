"""What pydantic found, in the words and with the key paths of the configuration file."""

import difflib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from agent.config.reading.fields import shown
from agent.errors import Fault

_TEXTS: Final[Mapping[str, str]] = {
    "missing": "is missing",
    "string_type": "must be text in quotes, not {input}",
    "float_type": "must be a number, not {input}",
    "float_parsing": "must be a number, not {input}",
    "int_type": "must be a whole number, not {input}",
    "int_parsing": "must be a whole number, not {input}",
    "int_from_float": "must be a whole number, not {input}",
    "int_parsing_size": "must be a whole number of at most 64 bits, not {input}",
    "string_too_short": "must not be empty",
    "string_too_long": "must have at most {max_length} letters, not {input}",
    "string_pattern_mismatch": "{input} is not of the form {pattern}",
    "bool_type": "must be true or false, not {input}",
    "bool_parsing": "must be true or false, not {input}",
    "finite_number": "must be a finite number, not {input}",
    "greater_than": "must be greater than {gt}, not {input}",
    "greater_than_equal": "must not be less than {ge}, not {input}",
    "less_than": "must be less than {lt}, not {input}",
    "less_than_equal": "must not be greater than {le}, not {input}",
    "tuple_type": "must be a list, not {input}",
    "list_type": "must be a list, not {input}",
    "dict_type": "must be a table, not {input}",
    "model_type": "must be a table, not {input}",
    "model_attributes_type": "must be a table, not {input}",
    "literal_error": "{input} is none of {expected}",
    "enum": "{input} is none of {expected}",
    "too_short": "must have at least {min_length} entries, not {actual_length}",
    "too_long": "must have at most {max_length} entries, not {actual_length}",
}
_ADVICE: Final[Mapping[str, str]] = {
    "missing": "add it",
    "string_type": "write it in quotes",
    "float_type": "write it as 0.25 or 1e-6, without quotes",
    "float_parsing": "write it as 0.25 or 1e-6, without quotes",
    "int_type": "write it without quotes and without a point",
    "int_parsing": "write it without quotes and without a point",
    "int_from_float": "write it without a point",
    "finite_number": "write it as 0.25 or 1e-6",
    "tuple_type": "write it in square brackets",
    "list_type": "write it in square brackets",
    "dict_type": "write it in braces or under a [heading] of its own",
    "model_type": "write it in braces or under a [heading] of its own",
    "model_attributes_type": "write it in braces or under a [heading] of its own",
}
_FOLLOWING: Final = "default_factory_not_called"
"""Pydantic's word for a default that rests on a key with a fault of its own, which is reported anyway."""
_NAME_RULE: Final = 'names are a letter and then at most 63 letters, digits, "_", "." or "-"'


def listing(names: Iterable[str]) -> str:
    """Join names for a message; "none" where there are none, and no more than a line of them."""
    names = list(names)
    more = f" and {len(names) - 20} more" if len(names) > 20 else ""
    return (", ".join(names[:20]) or "none") + more


def nearest(word: str, known: Iterable[str]) -> str:
    """Return the known word that is most like the given one; "" where none is known."""
    words = list(known)
    other_case = [name for name in words if name.casefold() == word.casefold()]
    return next(iter(other_case or difflib.get_close_matches(word[:100], words, n=1, cutoff=0.0)), "")


def unknown_key(path: str, key: str, known: Sequence[str]) -> Fault:
    """Make the fault of a key that its table does not have."""
    return Fault(
        join(path, key),
        "unknown key",
        f'the nearest known key is "{nearest(key, known)}" of {listing(known)}',
    )


def join(path: str, *parts: str | int) -> str:
    """Extend a key path: numbers in brackets, keys behind dots; odd keys are quoted."""
    for part in parts:
        if isinstance(part, int):
            path += f"[{part}]"
        else:
            key = part if part.replace("_", "").replace("-", "").isalnum() else shown(part)
            path += f".{key}" if path else key
    return path


def faults_of(error: ValidationError, path: str, raw: object, known: Sequence[str] = ()) -> list[Fault]:
    """Translate what pydantic found below `path`; of several at one place (branches of a choice) the first.

    known: the keys to choose the nearest from where a key is unknown.
    """
    found: dict[str, Fault] = {}
    for detail in error.errors(include_url=False):
        if detail["type"] == _FOLLOWING:
            continue
        where = join(path, *_within(raw, detail))
        found.setdefault(where, _fault(where, detail, known))
    return list(found.values())


def _within(raw: object, detail: ErrorDetails) -> list[str | int]:
    """Keep of pydantic's location what is in the file; it also names validators and branches of choices."""
    kept: list[str | int] = []
    for part in detail["loc"]:
        is_key = isinstance(raw, dict) and part in raw
        is_place = isinstance(raw, (list, tuple)) and isinstance(part, int)
        if is_key or is_place:
            kept.append(part)
            raw = _item(raw, part)
    if detail["type"] == "missing" and kept != list(detail["loc"]):
        kept.append(detail["loc"][-1])
    return kept


def _item(raw: Any, part: str | int) -> object:
    """Return what stands at a key or a place; None behind the end of a list."""
    try:
        found: object = raw[part]
    except IndexError:
        return None
    return found


def _fault(where: str, detail: ErrorDetails, known: Sequence[str]) -> Fault:
    kind = detail["type"]
    context = dict(detail.get("ctx", {}))
    if kind == "extra_forbidden":
        path, _, key = where.rpartition(".")
        return unknown_key(path, key or where, known)
    if kind == "string_pattern_mismatch" and context.get("pattern", "").startswith("^[A-Za-z]"):
        return Fault(where, f"{shown(detail['input'])} is not a name", _NAME_RULE)
    message, _, advice = _sentence(detail, context).partition("; ")
    return Fault(where, message, advice or _ADVICE.get(kind, ""))


def _sentence(detail: ErrorDetails, context: dict[str, Any]) -> str:
    if detail["type"] == "value_error":
        return str(context.get("error", detail["msg"]))
    text = _TEXTS.get(detail["type"])
    if text is None:
        return f"{shown(detail['input'])} cannot be: {detail['msg']}"
    context = {key: value for key, value in context.items() if key != "input"}
    if "expected" in context:
        context["expected"] = context["expected"].replace("'", '"').replace(" or ", ", ")
    return text.format(input=shown(detail["input"]), **_plain(context))


def _plain(context: dict[str, Any]) -> dict[str, Any]:
    return {key: f"{value:g}" if isinstance(value, float) else value for key, value in context.items()}
