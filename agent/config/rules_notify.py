"""What must hold in [[notify]]: names that differ, and the keys of each kind."""

from collections.abc import Iterator

from agent.config.draft import Draft
from agent.config.fields import shown
from agent.config.messages import join
from agent.config.notify import NEEDED, OWN, Notify, Secret
from agent.config.parse import readable
from agent.errors import Fault


def check_notify(draft: Draft) -> None:
    """Note the faults of targets."""
    taken: dict[str, str] = {}
    for path, target in draft.notify:
        if not readable(target.name, target.kind):
            continue
        if target.name in taken:
            what = f"{shown(target.name)} is the name of {taken[target.name]}"
            draft.faults.add(join(path, "name"), what, "names must differ")
        taken.setdefault(target.name, path)
        draft.faults.found += _faults(path, target)


def _faults(path: str, target: Notify) -> Iterator[Fault]:
    for key in NEEDED[target.kind]:
        if key not in target.model_fields_set:
            yield Fault(join(path, key), "is missing", f'kind = "{target.kind}" needs it')
    for kind, keys in OWN.items():
        for key in keys if kind != target.kind else ():
            if key in target.model_fields_set:
                yield Fault(join(path, key), f'belongs to kind = "{kind}"', "leave it out, or change the kind")
    for key in ("url", "token", "password"):
        secret = getattr(target, key)
        if isinstance(secret, Secret) and (secret.file is None) == (secret.env is None):
            yield Fault(join(path, key), "must name one place", '{ file = "..." } or { env = "..." }')
    url = target.url
    if isinstance(url, str) and not url.startswith(("http://", "https://")):
        yield Fault(join(path, "url"), f"{shown(url)} is no address", 'write "https://..."')
