# SPDX-License-Identifier: Apache-2.0
"""Findings: what was done to an algorithm, what came of it, and what helps."""

from __future__ import annotations

from dataclasses import dataclass, replace

from slamhive.model.base import Choice


class CheckAnswer(Choice):
    """Verdicts that a finding of a check can have."""

    PASS = "pass"  # noqa: S105 - no password
    WARNING = "warning"
    FAIL = "fail"
    SKIPPED = "skipped"


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        answer: what is to be thought of it.
        check: what it is, in a word or two.
        found: what was found, with the figures.
        help: what helps, in a sentence; of a failure always.
        did: what was done to find it.
        mode: the sensor mode; empty where it is all of them.
        executor: where it was found; empty where nothing was started.
    """

    answer: CheckAnswer
    check: str
    found: str
    help: str = ""
    did: str = ""
    mode: str = ""
    executor: str = ""

    def at(self, executor: str, mode: str, did: str = "") -> Finding:
        """Return it with where it was found."""
        return replace(self, executor=executor, mode=mode, did=self.did or did)

    def as_json(self) -> dict[str, str]:
        """Return it as a row of a table."""
        return {
            "executor": self.executor,
            "mode": self.mode,
            "check": self.check,
            "did": self.did,
            "found": self.found,
            "answer": self.answer.value,
            "help": self.help,
        }


def passed(check: str, found: str, help: str = "", did: str = "") -> Finding:  # noqa: A002
    """Return a finding that is as it should be."""
    return Finding(CheckAnswer.PASS, check, found, help, did)


def warned(check: str, found: str, help: str = "", did: str = "") -> Finding:  # noqa: A002
    """Return a finding that a user should know of, or that can't be told."""
    return Finding(CheckAnswer.WARNING, check, found, help, did)


def failed(check: str, found: str, help: str, did: str = "") -> Finding:  # noqa: A002
    """Return a finding that is wrong, with what helps."""
    return Finding(CheckAnswer.FAIL, check, found, help, did)


def skipped(check: str, found: str) -> Finding:
    """Return the finding of a check that could not look, with the reason."""
    return Finding(CheckAnswer.SKIPPED, check, found)
