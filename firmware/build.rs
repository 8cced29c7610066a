//! Gives linker and program the memory map of the board.

use std::env;
use std::error::Error;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

/// Chips with a map of their own; all others have the default board's.
const OWN_MAP: [(&str, &str); 3] = [
    ("CARGO_FEATURE_STM32G431", "memory/stm32g431cb.x"),
    ("CARGO_FEATURE_STM32G474", "memory/stm32g474re.x"),
    ("CARGO_FEATURE_BOARD_QEMU", "memory/qemu.x"),
];

/// Linker scripts; the map goes beside them as `map.x`.
const SCRIPTS: [&str; 7] = [
    "alone.x",
    "application.x",
    "bootloader.x",
    "layout.x",
    "sections.x",
    "start.x",
    "vectors.x",
];

/// The script of each program.
const PROGRAMS: [(&str, &str); 6] = [
    ("windlass-app", "application.x"),
    ("windlass-boot", "bootloader.x"),
    ("windlass-measure", "alone.x"),
    ("windlass-no-panic", "alone.x"),
    ("windlass-signatures", "alone.x"),
    ("windlass-trace", "alone.x"),
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
    let scripts = SCRIPTS.map(|name| (package.join("link").join(name), name));
    for (source, name) in scripts.iter().chain([&(map.clone(), "map.x")]) {
        fs::copy(source, out.join(name))?;
        println!("cargo:rerun-if-changed={}", source.display());
    }
    fs::write(out.join("map.rs"), constants(&map)?)?;
    println!("cargo:rustc-link-search={}", out.display());
    for (program, script) in PROGRAMS {
        println!("cargo:rustc-link-arg-bin={program}=-T{script}");
    }
    println!("cargo:rustc-link-arg-bins=--nmagic");
    if env::var_os("CARGO_FEATURE_LOG").is_some() {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
    Ok(())
}

/// The regions of a map as constants of a Rust module.
fn constants(map: &Path) -> Result<String, Box<dyn Error>> {
    let text = fs::read_to_string(map)?;
    let mut constants = String::new();
    for line in text.lines() {
        let Some((name, rest)) = line.split_once(": ORIGIN = ") else {
            continue;
        };
        let (origin, length) = rest
            .split_once(", LENGTH = ")
            .ok_or_else(|| format!("{}: no LENGTH in `{line}`", map.display()))?;
        let length = length.split_whitespace().next().unwrap_or_default();
        let length = match length.strip_suffix('K') {
            Some(kilobytes) => kilobytes.parse::<u32>()? * 1024,
            None => length.parse()?,
        };
        writeln!(
            constants,
            "pub(super) const {}: Region = Region {{ start: {origin}, length: {length} }};",
            name.trim()
        )?;
    }
    Ok(constants)
}
