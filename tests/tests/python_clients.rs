//! Runs the Python acceptance suite (`tests/python`) against the `windlass` binary of this build.
//!
//! The suite drives the bench with python-can exactly as a user does. Where Python, python-can or
//! pyserial is missing the test says so and passes, except in continuous integration (`CI=true`),
//! where a suite that did not run is a failure. `WINDLASS_PYTHON` names another interpreter, for
//! example the one of a virtual environment.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::SystemTime;

#[test]
fn python_clients_drive_the_bench() {
    let python = env::var("WINDLASS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    if let Err(reason) = check_modules(&python) {
        let message = format!(
            "the Python clients were not run: {reason}. Install them with `{python} -m pip install \
             python-can pyserial`, or name another interpreter in WINDLASS_PYTHON"
        );
        assert!(env::var("CI").as_deref() != Ok("true"), "{message}");
        eprintln!("SKIPPED: {message}");
        return;
    }
    let suite = Path::new(env!("CARGO_MANIFEST_DIR")).join("python/run.py");
    let output = Command::new(&python)
        .arg(suite)
        .arg(binary())
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .expect("the interpreter that was just asked for its modules runs");
    let report = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success(),
        "{}\n{report}",
        String::from_utf8_lossy(&output.stdout)
    );
    eprintln!("{report}");
}

/// Whether this interpreter has the two modules the suite needs; the reason if it has not.
fn check_modules(python: &str) -> Result<(), String> {
    match Command::new(python)
        .args(["-c", "import can, serial"])
        .output()
    {
        Ok(output) if output.status.success() => Ok(()),
        Ok(output) => Err(last_line(&output)),
        Err(error) => Err(format!("`{python}` can not be started ({error})")),
    }
}

fn last_line(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr);
    text.lines()
        .last()
        .unwrap_or("no module can be imported")
        .to_owned()
}

/// The `windlass` binary of the profile this test was built with.
///
/// Cargo builds the binary for the tests of its own package only, so with `-p windlass-tests`
/// it can be missing or older than its sources; then it is built here.
fn binary() -> PathBuf {
    let executable = env::current_exe().expect("a test knows its own path");
    let profile = executable
        .parent()
        .and_then(Path::parent)
        .expect("a test executable stands in <target>/<profile>/deps");
    let binary = profile.join(format!("windlass{}", env::consts::EXE_SUFFIX));
    if !is_fresh(&binary) {
        build(profile);
    }
    assert!(
        binary.exists(),
        "`cargo build` did not make {}",
        binary.display()
    );
    binary
}

/// Whether the binary is newer than every source in the dependency file beside it.
fn is_fresh(binary: &Path) -> bool {
    let Some(built) = modified(binary) else {
        return false;
    };
    let Ok(dependencies) = fs::read_to_string(binary.with_extension("d")) else {
        return false;
    };
    // One line, `binary: source source …`, with spaces inside a path escaped by a backslash.
    let sources = dependencies
        .lines()
        .filter_map(|line| line.split_once(": "))
        .map(|pair| pair.1);
    sources
        .flat_map(split_paths)
        .all(|source| modified(&source).is_some_and(|time| time <= built))
}

fn split_paths(line: &str) -> Vec<PathBuf> {
    let unescaped = line.replace("\\ ", "\0");
    unescaped
        .split_whitespace()
        .map(|path| PathBuf::from(path.replace('\0', " ")))
        .collect()
}

fn modified(path: &Path) -> Option<SystemTime> {
    fs::metadata(path)
        .and_then(|metadata| metadata.modified())
        .ok()
}

fn build(profile: &Path) {
    let name = profile
        .file_name()
        .and_then(|name| name.to_str())
        .unwrap_or("debug");
    let target = profile
        .parent()
        .expect("a profile's folder stands in the target folder");
    let cargo = env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let status = Command::new(cargo)
        .args(["build", "-p", "windlass", "--bin", "windlass", "--profile"])
        .arg(if name == "debug" { "dev" } else { name })
        .arg("--target-dir")
        .arg(target)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .status()
        .expect("cargo, which runs this test, starts");
    assert!(
        status.success(),
        "`cargo build -p windlass` failed; its messages are above"
    );
}
