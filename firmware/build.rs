//! Gives the linker the memory map of the board.

use std::env;
use std::error::Error;
use std::fs;
use std::path::PathBuf;

/// Boards with a map of their own; all others have the default board's.
const OWN_MAP: [(&str, &str); 2] = [
    ("CARGO_FEATURE_BOARD_B_G431B_ESC1", "memory/stm32g431cb.x"),
    ("CARGO_FEATURE_BOARD_NUCLEO_G474RE", "memory/stm32g474re.x"),
];

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
    let scripts = [
        (map, "map.x"),
        (package.join("layout.x"), "layout.x"),
        (package.join("link.x"), "windlass.x"),
    ];
    for (source, name) in scripts {
        fs::copy(&source, out.join(name))?;
        println!("cargo:rerun-if-changed={}", source.display());
    }
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rustc-link-arg-bins=-Twindlass.x");
    println!("cargo:rustc-link-arg-bins=--nmagic");
    if env::var_os("CARGO_FEATURE_LOG").is_some() {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
    Ok(())
}
