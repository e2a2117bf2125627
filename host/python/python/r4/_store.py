"""Records of studies as Parquet on object stores: S3, Google Cloud, Azure, HTTP, local files."""

from __future__ import annotations

import io
from typing import Any

#: Columns, as those of ``r4 system study --out FILE.parquet``: a row for each metric of each trial.
COLUMNS = ("system", "arm", "board", "seed", "failed", "metric", "value")


def packages() -> tuple[Any, Any, Any]:
    """Returns pyarrow, its Parquet module and obstore."""
    try:
        import obstore
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"object stores need {error.name}: pip install 'r4[store]'", name=error.name) from error
    return pyarrow, pyarrow.parquet, obstore


def place(url: str, options: dict[str, Any]) -> tuple[Any, str]:
    """Returns the store of a URL, and the name of the object in it."""
    *_, obstore = packages()
    folder, slash, name = url.rpartition("/")
    if not slash or "://" not in url or not name:
        raise ValueError(f"{url!r} is no URL of a file: give one such as s3://bucket/part-1.parquet or file:///tmp/part-1.parquet")
    # Folders of local stores are made, as those of other stores need not be.
    made = {"mkdir": True} if url.startswith("file:") else {}
    return obstore.store.from_url(folder, **made, **options), name


def write(url: str, records: list[dict[str, Any]], options: dict[str, Any]) -> None:
    """Writes records into a new object."""
    pyarrow, parquet, obstore = packages()
    store, name = place(url, options)
    rows: list[tuple[Any, ...]] = []
    for record in records:
        # A trial without values still has a row, so that reading gives it back.
        values = list(record.get("values", {}).items()) or [(None, None)]
        trial = tuple(record.get(column) for column in COLUMNS[:5])
        rows += [(*trial, metric, value) for metric, value in values]
    types = {"seed": pyarrow.uint64(), "value": pyarrow.float64()}
    schema = pyarrow.schema([(column, types.get(column, pyarrow.string())) for column in COLUMNS])
    columns = list(zip(*rows, strict=True)) or [()] * len(COLUMNS)
    table = pyarrow.table(dict(zip(COLUMNS, columns, strict=True)), schema=schema)
    bytes_ = io.BytesIO()
    parquet.write_table(table, bytes_)
    obstore.put(store, name, bytes_.getvalue())


def read(url: str, options: dict[str, Any]) -> list[dict[str, Any]]:
    """Reads the records that :func:`write` wrote, equal to the bit."""
    _, parquet, obstore = packages()
    store, name = place(url, options)
    table = parquet.read_table(io.BytesIO(bytes(obstore.get(store, name).bytes())))
    if missing := set(COLUMNS) - set(table.column_names):
        raise ValueError(f"{url} has no columns {sorted(missing)}: it is not a study's")
    records: list[dict[str, Any]] = []
    last = None
    for row in table.to_pylist():
        trial = tuple(row[column] for column in COLUMNS[:5])
        if trial != last:
            last = trial
            record = {column: row[column] for column in COLUMNS[:5] if row[column] is not None}
            records.append({**record, "values": {}})
        if row["metric"] is not None:
            records[-1]["values"][row["metric"]] = row["value"]
    return records
