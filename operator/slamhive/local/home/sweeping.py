# SPDX-License-Identifier: Apache-2.0
"""Names of sweeps: which versions and runs a name stands for in an archive, and another name for them.

A renamed sweep stays what it is: its identity, that of its runs, their names and their folders are as they
were, and only the name that is shown is another. A file that still has the earlier name is refused, as its
runs would be taken for those of both.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from slamhive.model.base import require_name
from slamhive.model.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from slamhive.analysis.derived import SweepVersion
    from slamhive.archive import Archive, SweepRecord
    from slamhive.model.sweep import Sweep

_LEAST_UID = 8


class Named(NamedTuple):
    """A sweep by name and place.

    Attributes:
        name: its name.
        namespace, cluster: where it is; None on a workstation.
        versions: as it was asked for, the latest last.
    """

    name: str
    namespace: str | None
    cluster: str | None
    versions: tuple[SweepVersion, ...]

    @property
    def uids(self) -> list[str]:
        """Return the identities of its versions."""
        return [version.uid for version in self.versions]


def named_sweeps(sweeps: Iterable[SweepVersion]) -> list[Named]:
    """Return sweeps by name and place, in the order in which they were last asked for."""
    found: dict[tuple[str, str | None, str | None], list[SweepVersion]] = {}
    for one in sorted(sweeps, key=lambda version: (version.created or 0.0, version.uid)):
        key = one.name, one.namespace, one.cluster
        # Taken out and put in again, so that what was asked for last stands last.
        found[key] = [*found.pop(key, []), one]
    return [Named(*key, tuple(versions)) for key, versions in found.items()]


def sweeps_meant(sweeps: Iterable[SweepRecord], name: str) -> list[SweepRecord]:
    """Return the versions that a name means: a name, NAMESPACE/NAME, or 8 digits of an identity.

    Raises:
        UnknownNameError: none is called so.
    """
    known = list(sweeps)
    namespace, slash, short = name.rpartition("/")
    found = [one for one in known if one.name == short and (not slash or (one.namespace or "") == namespace)]
    if not found and len(name) >= _LEAST_UID:
        found = [one for one in known if one.uid.startswith(name)]
    if not found:
        raise UnknownNameError("sweep", name, {one.name for one in known})
    return found


def rename_sweep(archive: Archive, old: str, new: str) -> int:
    """Give a sweep of this workstation, in all its versions, another name; all at once or not at all.

    Returns:
        The number of its runs.

    Raises:
        InputError: it is a cluster's, or the name is taken or none.
    """
    known = archive.sweeps()
    meant = sweeps_meant(known, old)
    if any(one.namespace is not None or one.cluster is not None for one in meant):
        raise InputError(f"sweep {old!r} is a cluster's, which knows it by this name: it keeps it")
    require_name(new, "NEW")
    here = [one for one in known if one.name == new and one.namespace is None and one.cluster is None]
    if here or archive.count(sweep=new):
        raise InputError(f"a sweep {new!r} is known already, and their runs would be mixed: choose another")
    return archive.rename_sweep([one.uid for one in meant], new)


def require_own_name(archive: Archive, sweeps: Sequence[Sweep]) -> None:
    """Refuse sweeps that were renamed since, and whose files have the earlier name.

    Raises:
        InputError: one was.
    """
    from slamhive.plan import local_uid  # noqa: PLC0415 - as below

    names = {one.uid: one.name for one in archive.sweeps()}
    for sweep in sweeps:
        now = names.get(local_uid(sweep), sweep.name)
        if now != sweep.name:
            raise InputError(
                f"sweep {sweep.name!r} was renamed to {now!r}: write that into its file (metadata.name), or "
                f"take it back: slamhive sweep rename {now} {sweep.name}"
            )
