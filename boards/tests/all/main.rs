//! Tests of robot and plant files, the built-in ones and bad ones.

mod bad_files;
mod built_in;
mod plants;
