"""Recordings as arrays, identification of unmodelled effects, and studies of robot systems."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, Union

import numpy as np
from numpy.typing import NDArray

from . import _native, _store

File: TypeAlias = Union[str, "os.PathLike[str]"]


@dataclass(frozen=True, eq=False)
class Signal:
    """One named series of a recording: times on the board's clock, s, and values in the unit at the end of the name."""

    name: str
    #: Meaning between samples: "continuous", "held", "changes" or "event".
    kind: str
    time_s: NDArray[np.float64]
    #: Numbers, with switches as 0 and 1; texts for a signal without numbers.
    value: NDArray[Any]


class Log(Mapping[str, Signal]):
    """A recording: maps names to signals, as in ``log["osmc0.position_rad"].value``."""

    def __init__(self, facts: dict[str, Any], signals: list[Signal], warnings: list[str]) -> None:
        self._signals = {signal.name: signal for signal in signals}
        self.robot: str = facts["robot"]
        self.board: str = facts["board"]
        self.firmware: str = facts["firmware"]
        #: Seed of a simulated board; None for a real one.
        self.seed: int | None = facts["seed"]
        self.duration_s: float = facts["duration_s"]
        #: Warnings about content of the file that could not be read.
        self.warnings = warnings

    def __getitem__(self, name: str) -> Signal:
        return self._signals[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._signals)

    def __len__(self) -> int:
        return len(self._signals)

    def __repr__(self) -> str:
        return f"<r4.Log of {self.board}, {self.duration_s:.3f} s, {len(self)} signals>"


def read_log(path: File) -> Log:
    """Reads a recording of ``r4 log record``, or of a session opened with ``log=``."""
    facts, series, warnings = _native.read_log(path)
    return Log(facts, [Signal(name, kind, t, np.asarray(v)) for name, kind, t, v in series], warnings)


@dataclass(frozen=True)
class Identified:
    """Result of an identification. ``report`` is that of ``r4 identify --json``: docs/identify.md describes its fields."""

    report: dict[str, Any]
    #: Text of a plant file that contains the effects, for ``r4.sim(plants=...)``; None for a model of a robot's body.
    plant: str | None

    @property
    def verdict(self) -> str:
        """Result of the identification in one sentence."""
        verdict: str = self.report["verdict"]
        return verdict

    @property
    def effects(self) -> list[str]:
        """Names of the effects that the base model lacks."""
        return [effect["name"] for effect in self.report["effects"]]


def identify(
    train: File | Sequence[File],
    holdout: File | Sequence[File],
    model: str,
    columns: Mapping[str, str] | None = None,
    *,
    parameters: Mapping[str, float] | None = None,
    time: str | None = None,
    split: Sequence[str] = (),
    plant: File | None = None,
    seed: int = 1,
    budget_s: float | None = None,
) -> Identified:
    """Fits a base model to recordings, and searches for the effects that it lacks.

    ``train`` are the recordings of the fit; ``holdout`` are held-out recordings, which decide nothing and grade the result, or
    ``"every:2"``. ``columns`` maps the model's roles to columns, as in ``{"input": "duty", "output": "theta_rad"}``; :func:`models`
    lists the roles. ``parameters`` are known values, as in ``{"supply_v": 24}``; ``split`` are columns that separate the runs of one
    file; ``budget_s`` ends the search after this time, which makes results depend on the computer.
    """
    report, text = _native.identify(
        _files(train),
        _files(holdout),
        model,
        dict(columns or {}),
        parameters=dict(parameters or {}),
        time=time,
        split=list(split),
        plant=plant,
        seed=seed,
        budget_s=budget_s,
    )
    return Identified(report, text)


def _files(files: File | Sequence[File]) -> list[File]:
    return [files] if isinstance(files, (str, os.PathLike)) else list(files)


def models() -> list[dict[str, Any]]:
    """Returns the base models of :func:`identify`, with their roles, parameters and effects."""
    return _native.models()


@dataclass(frozen=True)
class Study:
    """Result of a study: rows, one for each metric of each arm, with 95 % intervals; and the records of its trials."""

    rows: list[dict[str, Any]]
    records: list[dict[str, Any]]

    def to_parquet(self, url: str, **options: Any) -> None:
        """Writes the records as Parquet to any object store: ``s3://``, ``gs://``, ``az://``, ``https://`` or ``file:///``.

        Credentials come from the environment, as the tools of the store take them. ``options`` go to ``obstore.store.from_url``.
        Needs ``pip install 'r4[store]'``.
        """
        _store.write(url, self.records, options)


def read_study(url: str, **options: Any) -> Study:
    """Reads records that :meth:`Study.to_parquet` wrote. The result has no rows: :func:`merge` combines all parts and makes them."""
    return Study([], _store.read(url, options))


def study(
    system: str,
    *,
    arms: Sequence[str] = (),
    first_seed: int | None = None,
    seeds: int = 20,
    board: str | None = None,
    shard: str | None = None,
    engine: Literal["threads", "ray"] = "threads",
) -> Study:
    """Runs arms of a robot system (:func:`systems`) over seeds, as ``r4 system study`` does.

    ``arms`` selects arms, all by default. ``first_seed`` is by default the first of those on which the system's results are reported.
    ``board`` selects a board, by default the system's own. ``shard="2/4"`` runs a part of the
    trials: its result has records and no rows, and :func:`merge` combines all parts.

    ``engine`` is ``"threads"``, all cores of this machine, or ``"ray"``, the Ray cluster that ``ray.init`` has connected to, or a local
    one. Results are the same to the bit, also when workers die in between: their parts are run again.
    """
    if engine == "ray":
        if shard is not None:
            raise ValueError("engine=\"ray\" makes shards of its own: leave shard out")
        from . import _ray

        asked = {"system": system, "arms": list(arms), "first_seed": first_seed, "seeds": seeds, "board": board}
        return merge(_ray.parts(asked))
    if engine != "threads":
        raise ValueError(f"engine={engine!r}: give \"threads\" or \"ray\"")
    rows, records = _native.study(
        system, arms=list(arms), first_seed=first_seed, seeds=seeds, board=board, shard=shard
    )
    return Study(rows, records)


def merge(parts: Sequence[Study]) -> Study:
    """Combines the parts of a study; the result is that of the whole study, bit for bit."""
    rows, records = _native.merge([json.dumps(part.records) for part in parts])
    return Study(rows, records)


def systems() -> list[str]:
    """Returns the names of the robot systems."""
    return _native.systems()
