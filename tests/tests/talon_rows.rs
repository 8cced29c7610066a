//! The page that maps the rows of the Talon SRX manual to tests names every row once and only tests that exist.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Every source file below a folder.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// Names of the functions that stand below a `#[test]`, with whether the test is ignored.
fn tests_of(text: &str) -> Vec<(String, bool)> {
    let mut tests = Vec::new();
    let (mut is_test, mut ignored) = (false, false);
    for line in text.lines().map(str::trim) {
        if line == "#[test]" {
            (is_test, ignored) = (true, false);
        } else if line.starts_with("#[ignore") {
            ignored = true;
        } else if let Some(rest) = line.strip_prefix("fn ") {
            if is_test && let Some((name, _)) = rest.split_once('(') {
                tests.push((name.to_owned(), ignored));
            }
            is_test = false;
        }
    }
    tests
}

struct Row {
    number: u32,
    shown_by: String,
}

fn rows() -> Vec<Row> {
    let page = fs::read_to_string(root().join("docs/talon-srx-rows.md")).unwrap();
    let rows = page.lines().filter_map(|line| {
        let cells: Vec<&str> = line.strip_prefix('|')?.split('|').map(str::trim).collect();
        let number = cells.first()?.parse().ok()?;
        let shown_by = (*cells.get(3)?).to_owned();
        Some(Row { number, shown_by })
    });
    rows.collect()
}

#[test]
fn every_row_is_there_once_and_says_what_shows_it() {
    let rows = rows();
    let numbers: Vec<u32> = rows.iter().map(|row| row.number).collect();
    assert_eq!(numbers, (1..=102).collect::<Vec<_>>());
    for row in &rows {
        let says = ["`", "no device behaviour", "no protocol behaviour", "see ["];
        let said = says.iter().any(|word| row.shown_by.contains(word));
        assert!(said, "row {} says nothing", row.number);
    }
}

#[test]
fn every_named_test_exists_and_an_ignored_one_is_called_not_done() {
    let mut files = Vec::new();
    for folder in ["core", "host", "hal-sim", "tests"] {
        sources(&root().join(folder), &mut files);
    }
    let tests: Vec<(String, bool)> = files
        .iter()
        .flat_map(|path| tests_of(&fs::read_to_string(path).unwrap()))
        .collect();
    let existing: BTreeSet<&str> = tests.iter().map(|(name, _)| name.as_str()).collect();
    let ignored: BTreeSet<&str> = tests
        .iter()
        .filter(|(_, ignored)| *ignored)
        .map(|(name, _)| name.as_str())
        .collect();
    for row in rows() {
        let named = row.shown_by.split('`').skip(1).step_by(2);
        for name in named.filter(|name| !name.starts_with("windlass")) {
            assert!(
                existing.contains(name),
                "row {}: there is no test {name}",
                row.number
            );
            let open = row.shown_by.contains("**not done**");
            assert!(
                !ignored.contains(name) || open,
                "row {}: {name} is ignored",
                row.number
            );
        }
    }
    // And the other way: what is named after a row stands in that row.
    let text = fs::read_to_string(root().join("docs/talon-srx-rows.md")).unwrap();
    for name in existing.iter().filter(|name| name.starts_with("row_")) {
        assert!(
            text.contains(&format!("`{name}`")),
            "{name} stands in no row"
        );
    }
}
