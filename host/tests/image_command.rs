//! `windlass image` from the outside.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use windlass_core::boot::image::{Hardware, INFO_OFFSET, Identity, InfoBlock, PAGE_SIZE};
use windlass_core::node::PRODUCT_DMC60C;

/// A folder of its own for each test, gone at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("image-{name}"));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn path(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_owned()
    }

    /// A linker's binary of two pages.
    fn application(&self, name: &str) -> String {
        let mut bytes = vec![0x5A; 2 * PAGE_SIZE];
        let identity = Identity {
            product: PRODUCT_DMC60C,
            hardware: Hardware::F405.id,
            version: 0x0203,
            rollback: 4,
        };
        let info = InfoBlock { identity }.to_bytes();
        bytes[INFO_OFFSET..INFO_OFFSET + info.len()].copy_from_slice(&info);
        let path = self.path(name);
        fs::write(&path, bytes).unwrap();
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn windlass(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_windlass"))
        .args(arguments)
        .output()
        .unwrap()
}

fn done(arguments: &[&str]) -> String {
    let output = windlass(arguments);
    let errors = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {errors}");
    String::from_utf8(output.stdout).unwrap()
}

fn document(arguments: &[&str]) -> Value {
    serde_json::from_str(&done(&[&["--json"], arguments].concat())).unwrap()
}

fn fails(arguments: &[&str], code: i32, part: &str) {
    let output = windlass(arguments);
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {text}");
    assert!(
        text.starts_with("error: ") && text.contains("\nnext: "),
        "{text}"
    );
    assert!(text.contains(part), "{part}: {text}");
}

#[test]
fn an_application_is_inspected_packed_signed_and_verified() {
    let folder = Folder::new("whole");
    let binary = folder.application("app.bin");
    let raw = document(&["image", "inspect", &binary]);
    assert_eq!(
        (&raw["version"], &raw["sealed"]),
        (&"2.3".into(), &false.into())
    );
    fails(&["image", "verify", &binary], 8, "no seal");

    let packed = document(&["image", "pack", &binary]);
    let image = folder.path("app.wlimg");
    assert_eq!(packed["file"], image.as_str());
    assert_eq!(
        (&packed["pages"], &packed["hardware"]),
        (&3.into(), &"stm32f405".into())
    );
    assert!(done(&["image", "verify", &image]).contains("whole, not signed"));

    let name = folder.path("maker");
    let (secret, public) = (folder.path("maker.key"), folder.path("maker.pub"));
    let made = done(&["image", "keygen", &name]);
    let digits = fs::read_to_string(&secret).unwrap();
    assert!(
        !made.contains(digits.lines().nth(1).unwrap()),
        "the secret is printed"
    );
    fails(
        &["image", "verify", &image, "--key", &public],
        8,
        "not signed",
    );
    done(&["image", "sign", &image, "--key", &secret]);
    let signed = folder.path("app.signed.wlimg");
    let checked = document(&["image", "verify", &signed, "--key", &public]);
    assert_eq!(checked["signature_checked"], true);
    done(&["image", "keygen", &folder.path("other")]);
    fails(
        &[
            "image",
            "verify",
            &signed,
            "--key",
            &folder.path("other.pub"),
        ],
        8,
        "not of this key",
    );

    for extension in ["hex", "bin", "crf"] {
        let other = folder.path(&format!("out.{extension}"));
        done(&[
            "image", "sign", &signed, "--key", &secret, "--output", &other,
        ]);
        let text = done(&["image", "inspect", &other]);
        assert!(text.contains("signature    yes"), "{text}");
        assert!(text.contains("pages        0-1, 30"), "{text}");
    }
}

#[test]
fn keys_are_not_overwritten_and_not_read_when_others_may() {
    let folder = Folder::new("keys");
    let name = folder.path("maker");
    done(&["image", "keygen", &name]);
    let before = fs::read(folder.path("maker.key")).unwrap();
    fails(&["image", "keygen", &name], 8, "exists already");
    fs::remove_file(folder.path("maker.pub")).unwrap();
    fails(&["image", "keygen", &name], 8, "exists already");
    assert_eq!(fs::read(folder.path("maker.key")).unwrap(), before);
    let image = folder.application("app.bin");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let secret = folder.path("maker.key");
        let mode = fs::metadata(&secret).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        fs::set_permissions(&secret, fs::Permissions::from_mode(0o640)).unwrap();
        fails(&["image", "sign", &image, "--key", &secret], 8, "chmod 600");
    }
    for (content, name) in [
        ("", "empty.pub"),
        ("windlass public key 1\nxyz\n", "bad.pub"),
    ] {
        fs::write(folder.path(name), content).unwrap();
        let key = folder.path(name);
        fails(
            &["image", "verify", &image, "--key", &key],
            8,
            "is no public key",
        );
    }
}

#[test]
fn files_that_cannot_be_used_end_with_8_and_wrong_usage_with_2() {
    let folder = Folder::new("bad");
    let binary = folder.application("app.bin");
    fails(
        &["image", "inspect", &folder.path("none.hex")],
        8,
        "none.hex",
    );
    fs::write(folder.path("empty"), "").unwrap();
    fails(&["image", "inspect", &folder.path("empty")], 8, "empty");
    fs::write(folder.path("notes.txt"), "hello").unwrap();
    fails(
        &["image", "inspect", &folder.path("notes.txt")],
        8,
        "known format",
    );
    fails(
        &["image", "pack", &binary, "--output", &binary],
        2,
        "--output",
    );
    fails(
        &[
            "image",
            "pack",
            &binary,
            "--output",
            &folder.path("out.txt"),
        ],
        2,
        "extension",
    );
    fails(
        &[
            "image",
            "pack",
            &binary,
            "--output",
            &folder.path("out.elf"),
        ],
        2,
        "ELF",
    );
    let nowhere = folder.path("missing/out.hex");
    fails(
        &["image", "pack", &binary, "--output", &nowhere],
        8,
        "cannot write",
    );
    fails(&["image"], 2, "");
}
