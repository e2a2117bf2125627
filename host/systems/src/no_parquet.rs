//! Replaces `parquet.rs` in programs built without the feature `parquet`: writing returns an error.

use std::path::Path;

use crate::{Error, Record};

pub(crate) fn write(path: &Path, _: &[Record]) -> Result<(), Error> {
    let why = "this program is built without Parquet: build it with `--features parquet`, or name a file that does not end in .parquet";
    Err(Error::Parquet { path: path.to_owned(), why: why.to_owned() })
}
