//! `windlass image`: look at firmware files, seal and sign them.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use serde_json::{Value, json};
use windlass_core::boot::image::{Hardware, INFO_OFFSET, Identity, InfoBlock, pages_of};

use super::output::{self, say};
use super::{Failure, Global, Kind, Outcome};
use crate::client::{Selector, Version};
use crate::flash::{self, Unobserved};
use crate::image::key::{self, KeyError};
use crate::image::{Contents, FileError, Format, Image, load};

/// Arguments of `windlass image`.
#[derive(Clone, Debug, Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Clone, Debug, Subcommand)]
enum Action {
    /// Show what a firmware file holds.
    Inspect {
        /// An .elf, .hex, .bin, .wlimg or .crf file.
        file: PathBuf,
    },
    /// Seal what a linker made: give it the header with its CRC.
    Pack {
        /// An .elf, .hex or .bin file.
        file: PathBuf,
        /// Where to; its extension tells the format. FILE with .wlimg if left out.
        #[arg(long, short, value_name = "FILE")]
        output: Option<PathBuf>,
    },
    /// Sign an image.
    Sign {
        /// A sealed file.
        file: PathBuf,
        /// The signing key, NAME.key.
        #[arg(long, value_name = "FILE")]
        key: PathBuf,
        /// Where to; its extension tells the format. FILE with .signed.wlimg if left out.
        #[arg(long, short, value_name = "FILE")]
        output: Option<PathBuf>,
    },
    /// Make a pair of keys, NAME.key and NAME.pub.
    Keygen {
        /// Path of the files without extension.
        name: PathBuf,
    },
    /// Let a device accept only images that are signed with a key. This cannot be taken back.
    InstallKey {
        /// The device, as 5, talon:5, @0x1234 or 5@0x1234.
        device: Selector,
        /// The public key, NAME.pub.
        key: PathBuf,
        /// The signing key that belongs to the key which the device holds now.
        #[arg(long, value_name = "FILE")]
        replaces: Option<PathBuf>,
        /// Yes, for good.
        #[arg(long, required = true)]
        permanently: bool,
    },
    /// Check that a file is whole, and signed if a key is given.
    Verify {
        /// A sealed file.
        file: PathBuf,
        /// The public key, NAME.pub.
        #[arg(long, value_name = "FILE")]
        key: Option<PathBuf>,
    },
}

/// Runs the action.
pub(super) fn run(arguments: &Arguments, global: &Global) -> Result<Outcome, Failure> {
    match &arguments.action {
        Action::Inspect { file } => inspect(file, global),
        Action::Pack { file, output } => pack(file, output.as_deref(), global),
        Action::Sign { file, key, output } => sign(file, key, output.as_deref(), global),
        Action::Keygen { name } => keygen(name, global),
        Action::InstallKey {
            device,
            key,
            replaces,
            permanently: _,
        } => install_key(device, key, replaces.as_deref(), global),
        Action::Verify { file, key } => verify(file, key.as_deref(), global),
    }
}

/// A failure that names the file.
pub(super) fn file_failure(path: &Path, error: &FileError) -> Failure {
    let message = match error {
        FileError::Read { .. } => error.to_string(),
        _ => format!("{}: {error}", path.display()),
    };
    Failure::new(Kind::File, message, error.next_step())
}

impl From<KeyError> for Failure {
    fn from(error: KeyError) -> Self {
        Self::new(Kind::File, error.to_string(), error.next_step())
    }
}

fn open(path: &Path) -> Result<Contents, Failure> {
    load(path).map_err(|error| file_failure(path, &error))
}

fn sealed(path: &Path) -> Result<Image, Failure> {
    open(path)
        .and_then(|contents| Image::sealed(contents).map_err(|error| file_failure(path, &error)))
}

fn inspect(path: &Path, global: &Global) -> Result<Outcome, Failure> {
    let contents = open(path)?;
    let info = contents
        .pages
        .get(0)
        .map(|page| InfoBlock::parse(&page[INFO_OFFSET..]));
    let Some(Ok(InfoBlock { identity })) = info else {
        return Err(file_failure(path, &FileError::NoApplication));
    };
    let image = if contents.is_sealed() {
        let whole = Image::sealed(contents.clone());
        Some(whole.map_err(|error| file_failure(path, &error))?)
    } else {
        None
    };
    if global.json {
        let mut document = describe(&identity, &contents);
        document["format"] = json!(contents.format.name());
        document["sealed"] = json!(image.is_some());
        document["image_crc"] = json!(image.as_ref().map(|image| image.header().image_crc));
        let signed = image.as_ref().map(|image| image.header().signed);
        document["signed"] = json!(signed.unwrap_or(false));
        document["notices"] = json!(contents.notices);
        output::json(&document)?;
        return Ok(Outcome::Done);
    }
    say!("{}", path.display())?;
    say!("  {:<12} {}", "format", contents.format.name())?;
    say!("  {:<12} {:#010x}", "product id", identity.product)?;
    say!("  {:<12} {}", "hardware", hardware_name(&identity))?;
    say!("  {:<12} {}", "version", Version(identity.version))?;
    say!("  {:<12} {}", "rollback", identity.rollback)?;
    say!("  {:<12} {}", "pages", page_list(contents.pages.bitmap()))?;
    match &image {
        Some(image) => {
            let signed = image.header().signed;
            say!(
                "  {:<12} CRC {:#010x}, whole",
                "seal",
                image.header().image_crc
            )?;
            say!(
                "  {:<12} {}",
                "signature",
                if signed { "yes" } else { "none" }
            )?;
        }
        None => say!("  {:<12} none: seal it with `windlass image pack`", "seal")?,
    }
    print_notices(&contents)?;
    Ok(Outcome::Done)
}

fn describe(identity: &Identity, contents: &Contents) -> Value {
    let pages: Vec<u8> = pages_of(contents.pages.bitmap()).collect();
    json!({
        "product_id": identity.product,
        "hardware_id": identity.hardware,
        "hardware": hardware_name(identity),
        "version": Version(identity.version).to_string(),
        "rollback": identity.rollback,
        "pages": pages,
    })
}

fn hardware_name(identity: &Identity) -> &'static str {
    Hardware::from_id(identity.hardware).map_or("unknown", |row| row.name)
}

/// Page numbers as ranges, such as `0-2, 30`.
fn page_list(bitmap: u32) -> String {
    let mut ranges: Vec<(u8, u8)> = Vec::new();
    for page in pages_of(bitmap) {
        match ranges.last_mut() {
            Some((_, last)) if *last + 1 == page => *last = page,
            _ => ranges.push((page, page)),
        }
    }
    let texts: Vec<String> = ranges
        .into_iter()
        .map(|(first, last)| match last - first {
            0 => first.to_string(),
            _ => format!("{first}-{last}"),
        })
        .collect();
    texts.join(", ")
}

fn print_notices(contents: &Contents) -> Result<(), Failure> {
    contents
        .notices
        .iter()
        .try_for_each(|notice| say!("note: {notice}"))
}

fn pack(path: &Path, to: Option<&Path>, global: &Global) -> Result<Outcome, Failure> {
    let to = to.map_or_else(|| path.with_extension("wlimg"), Path::to_owned);
    let format = output_format(&to)?;
    let contents = open(path)?;
    let base = contents.base;
    if !global.json {
        print_notices(&contents)?;
    }
    let source = contents.format;
    let image = Image::packed(contents).map_err(|error| file_failure(path, &error))?;
    let bytes = match format {
        Format::Elf => Some(sealed_elf(path, source, &image, base)?),
        other => image.write(other),
    };
    write(path, &to, bytes.unwrap_or_default())?;
    report(&to, &image, global)
}

fn sealed_elf(path: &Path, source: Format, image: &Image, base: u32) -> Result<Vec<u8>, Failure> {
    if source != Format::Elf {
        return Err(Failure::new(
            Kind::Usage,
            "an ELF file can only be made from an ELF file",
            "give the output the extension .wlimg, .hex, .bin or .crf",
        ));
    }
    let file = std::fs::read(path).map_err(|source| {
        let path = path.to_owned();
        file_failure(&path.clone(), &FileError::Read { path, source })
    })?;
    image
        .seal_elf(&file, base)
        .map_err(|error| file_failure(path, &error))
}

fn sign(path: &Path, key: &Path, to: Option<&Path>, global: &Global) -> Result<Outcome, Failure> {
    let to = to.map_or_else(|| path.with_extension("signed.wlimg"), Path::to_owned);
    let format = output_format(&to)?;
    if format == Format::Elf {
        return Err(Failure::new(
            Kind::Usage,
            "a signed image is not written as ELF",
            "give the output the extension .wlimg, .hex, .bin or .crf",
        ));
    }
    let key = key::read_secret(key)?;
    let image = sealed(path)?.signed(&key);
    write(path, &to, image.write(format).unwrap_or_default())?;
    report(&to, &image, global)
}

fn output_format(path: &Path) -> Result<Format, Failure> {
    Format::of_name(path).ok_or_else(|| {
        Failure::new(
            Kind::Usage,
            format!("the extension of {} names no format", path.display()),
            "give the output the extension .wlimg, .hex, .bin, .crf or .elf",
        )
    })
}

/// Writes a file whole or not at all: under another name first, then renamed.
fn write(from: &Path, to: &Path, bytes: Vec<u8>) -> Result<(), Failure> {
    let same = from.canonicalize().ok().zip(to.canonicalize().ok());
    if same.is_some_and(|(from, to)| from == to) {
        return Err(Failure::new(
            Kind::Usage,
            format!(
                "{} would be overwritten by what is made from it",
                from.display()
            ),
            "give another file with --output",
        ));
    }
    let mut part = to.as_os_str().to_owned();
    part.push(".part");
    let part = PathBuf::from(part);
    let written = std::fs::File::create(&part).and_then(|mut file| {
        file.write_all(&bytes)?;
        file.sync_all()?;
        std::fs::rename(&part, to)
    });
    written.map_err(|error| {
        // Whatever was written is of no use; the first error is the one to tell.
        let _ = std::fs::remove_file(&part);
        Failure::new(
            Kind::File,
            format!("cannot write {}: {error}", to.display()),
            "check that the folder exists, is writable and has room",
        )
    })
}

fn report(to: &Path, image: &Image, global: &Global) -> Result<Outcome, Failure> {
    let header = image.header();
    let version = Version(header.identity.version);
    if global.json {
        output::json(&json!({
            "file": to.display().to_string(),
            "version": version.to_string(),
            "hardware": image.hardware_name(),
            "pages": image.pages().len(),
            "image_crc": header.image_crc,
            "signed": header.signed,
        }))?;
        return Ok(Outcome::Done);
    }
    let signed = if header.signed { ", signed" } else { "" };
    say!(
        "{}: version {version} for {}, {} pages, CRC {:#010x}{signed}",
        to.display(),
        image.hardware_name(),
        image.pages().len(),
        header.image_crc
    )?;
    Ok(Outcome::Done)
}

fn keygen(name: &Path, global: &Global) -> Result<Outcome, Failure> {
    let (secret, public, key) = key::generate(name)?;
    let fingerprint = key::fingerprint(&key);
    if global.json {
        output::json(&json!({
            "signing_key": secret.display().to_string(),
            "public_key": public.display().to_string(),
            "fingerprint": fingerprint,
        }))?;
        return Ok(Outcome::Done);
    }
    say!(
        "{}: signing key {fingerprint}; keep it secret and keep a copy",
        secret.display()
    )?;
    say!("{}: public key, for devices", public.display())?;
    Ok(Outcome::Done)
}

fn install_key(
    selector: &Selector,
    key: &Path,
    replaces: Option<&Path>,
    global: &Global,
) -> Result<Outcome, Failure> {
    let key = key::read_public(key)?;
    let old = replaces.map(key::read_secret).transpose()?;
    let order = key::install_order(&key, old.as_ref());
    let mut client = global.connect()?;
    let device = client.find(selector)?;
    flash::install_key(&mut client, &device, &order, &mut Unobserved)?;
    let fingerprint = key::fingerprint(&key);
    if global.json {
        output::json(&json!({
            "device": device.address.to_string(),
            "fingerprint": fingerprint,
        }))?;
        return Ok(Outcome::Done);
    }
    say!(
        "device {} accepts only images signed with key {fingerprint} from now on",
        device.address
    )?;
    Ok(Outcome::Done)
}

fn verify(path: &Path, key: Option<&Path>, global: &Global) -> Result<Outcome, Failure> {
    let key = key.map(key::read_public).transpose()?;
    let image = sealed(path)?;
    let unsigned = "sign it with `windlass image sign FILE --key NAME.key`";
    match key.as_ref().map(|key| image.verify_signature(key)) {
        Some(None) => {
            let message = format!("{}: the image is not signed", path.display());
            return Err(Failure::new(Kind::File, message, unsigned));
        }
        Some(Some(false)) => {
            let message = format!("{}: the signature is not of this key", path.display());
            return Err(Failure::new(
                Kind::File,
                message,
                "get the file again, or the public key that belongs to the signing key",
            ));
        }
        Some(Some(true)) | None => {}
    }
    if global.json {
        output::json(&json!({
            "file": path.display().to_string(),
            "whole": true,
            "signed": image.header().signed,
            "signature_checked": key.is_some(),
            "version": Version(image.header().identity.version).to_string(),
        }))?;
        return Ok(Outcome::Done);
    }
    let signature = match (&key, image.header().signed) {
        (Some(key), _) => format!("signed with key {}", key::fingerprint(key)),
        (None, true) => "signed (give --key to check by whom)".to_owned(),
        (None, false) => "not signed".to_owned(),
    };
    say!("{}: whole, {signature}", path.display())?;
    Ok(Outcome::Done)
}
