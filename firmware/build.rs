//! Gives the linker the memory map of the board.

use std::env;
use std::error::Error;
use std::fs;
use std::path::PathBuf;

/// Boards with a map of their own; all others have the default board's.
const OWN_MAP: [(&str, &str); 0] = [];

fn main() -> Result<(), Box<dyn Error>> {
    if env::var("CARGO_CFG_TARGET_OS")? != "none" {
        return Ok(());
    }
    let package = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?);
    let out = PathBuf::from(env::var("OUT_DIR")?);
    let map = OWN_MAP
        .iter()
        .find(|(feature, _)| env::var_os(feature).is_some())
        .map_or_else(|| package.join("../memory.x"), |(_, map)| package.join(map));
    let layout = package.join("layout.x");
    fs::copy(&map, out.join("memory.x"))?;
    fs::copy(&layout, out.join("layout.x"))?;
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    println!("cargo:rustc-link-arg-bins=--nmagic");
    println!("cargo:rerun-if-changed={}", map.display());
    println!("cargo:rerun-if-changed={}", layout.display());
    Ok(())
}
