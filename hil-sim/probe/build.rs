//! Copies the memory layout to the place where the linker finds it.

use std::{env, fs, path::PathBuf};

fn main() {
    let layout = if env::var_os("CARGO_FEATURE_AN500").is_some() { "layout/an500.x" } else { "layout/stm32h747.x" };
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::copy(layout, out.join("memory.x")).expect("the layout can be copied");
    println!("cargo::rustc-link-search={}", out.display());
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    // Absolute addresses of zero are valid in the an500's vector table.
    println!("cargo::rustc-link-arg-bins=--nmagic");
    println!("cargo::rerun-if-changed=layout");
}
