"""Parts of a study on object stores: local files, and S3 as the server of moto (PyPI) has it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import boto3
import pyarrow
import pyarrow.parquet
import pytest
import r4
from moto.server import ThreadedMotoServer

SYSTEM, SEEDS, PARTS = "tail", 3, 3


@pytest.fixture(scope="module")
def whole() -> r4.Study:
    return r4.study(SYSTEM, seeds=SEEDS)


@pytest.fixture(scope="module")
def parts() -> list[r4.Study]:
    return [r4.study(SYSTEM, seeds=SEEDS, shard=f"{part}/{PARTS}") for part in range(1, PARTS + 1)]


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, dict[str, Any]]]:
    """A bucket of an S3 server on this machine, and the options by which it is reached."""
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "test")
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    options = {"endpoint": f"http://{host}:{port}", "region": "us-east-1", "client_options": {"allow_http": True}}
    made = boto3.client("s3", endpoint_url=options["endpoint"], region_name="us-east-1")
    made.create_bucket(Bucket="studies")
    yield "s3://studies/run-1", options
    server.stop()


def test_parts_on_s3_merge_to_the_bit(
    whole: r4.Study, parts: list[r4.Study], bucket: tuple[str, dict[str, Any]]
) -> None:
    folder, options = bucket
    urls = [f"{folder}/part-{number}.parquet" for number in range(1, PARTS + 1)]
    for part, url in zip(parts, urls, strict=True):
        part.to_parquet(url, **options)
    merged = r4.merge([r4.read_study(url, **options) for url in urls])
    assert merged.records == whole.records and merged.rows == whole.rows
    # A part that is run again replaces its object.
    parts[1].to_parquet(urls[1], **options)
    assert r4.read_study(urls[1], **options).records == parts[1].records


def test_records_come_back_from_a_file(whole: r4.Study, tmp_path: Path) -> None:
    failed = {"system": SYSTEM, "arm": "ours", "board": "sim", "seed": 2**64 - 1, "values": {}, "failed": "no link"}
    odd = {"system": SYSTEM, "arm": "ours", "board": "sim", "seed": 0, "values": {"a": 5e-324, "b": -0.0}}
    study = r4.Study([], [*whole.records, failed, odd])
    url = f"file://{tmp_path}/new/folder/all.parquet"
    study.to_parquet(url)
    read = r4.read_study(url).records
    assert read == study.records
    # Equality does not see the sign of zero.
    assert str(read[-1]["values"]) == str(odd["values"])
    empty = f"file://{tmp_path}/empty.parquet"
    r4.Study([], []).to_parquet(empty)
    assert r4.read_study(empty).records == []


def test_what_cannot_be_stored_says_so(tmp_path: Path) -> None:
    for url in ("all.parquet", "s3://", f"file://{tmp_path}/"):
        with pytest.raises(ValueError, match="no URL of a file"):
            r4.Study([], []).to_parquet(url)
    with pytest.raises(FileNotFoundError):
        r4.read_study(f"file://{tmp_path}/nothing.parquet")
    other = tmp_path / "other.parquet"
    pyarrow.parquet.write_table(pyarrow.table({"x": [1]}), other)
    with pytest.raises(ValueError, match="not a study's"):
        r4.read_study(f"file://{other}")
