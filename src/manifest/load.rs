//! From a file to a validated manifest: bytes, text, TOML, draft, manifest, each with its faults.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;

use toml::de::DeTable;

use crate::manifest::commas::decimal_commas;
use crate::manifest::declared::Manifest;
use crate::manifest::read::newer_format;
use crate::manifest::value::sweep::{Reader, Runs};
use crate::manifest::{check, complete};
use crate::text::{Document, Fault, FaultList, Faults, Source, Span, document};

/// Maximum size of a manifest in bytes; ranges keep large sweeps short.
const MOST_BYTES: u64 = 10_000_000;

/// Reads and validates the manifest at `path`.
///
/// # Errors
/// Every fault of the file, with positions.
pub fn load(path: &Path) -> Result<Manifest, Faults> {
    load_from(path, Runs::default())
}

/// [`load`], with values that name jobs.
pub(super) fn load_from(path: &Path, runs: Runs) -> Result<Manifest, Faults> {
    let label = path.display().to_string();
    let bytes = read(path).map_err(|fault| Faults::of_file(&label, fault))?;
    parse_from(&label, &bytes, runs)
}

fn read(path: &Path) -> Result<Vec<u8>, Fault> {
    let unreadable = |error: io::Error| match error.kind() {
        io::ErrorKind::NotFound => Fault::whole("no such file")
            .help("check the path; the shipped manifests are in experiments/"),
        io::ErrorKind::PermissionDenied => {
            Fault::whole("permission denied").help("make the file readable for this user")
        }
        _ => Fault::whole(format!("cannot be read: {error}")),
    };
    let kind = fs::metadata(path).map_err(unreadable)?;
    if kind.is_dir() {
        let fault = Fault::whole("is a directory, not a manifest");
        return Err(fault.help("name the files in it, as in experiments/*.toml"));
    }
    // Opening a pipe could block forever.
    if !kind.is_file() {
        return Err(Fault::whole("is not a regular file").help("write the manifest to a file"));
    }
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(unreadable)?;
    file.take(MOST_BYTES + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    Ok(bytes)
}

/// Validates a manifest's bytes; messages call the file `path`.
///
/// # Errors
/// Every fault of the text, with positions.
pub fn parse(path: &str, bytes: &[u8]) -> Result<Manifest, Faults> {
    parse_from(path, bytes, Runs::default())
}

/// [`parse`], with values that name jobs.
pub(super) fn parse_from(path: &str, bytes: &[u8], runs: Runs) -> Result<Manifest, Faults> {
    let (manifest, mut faults, lost) = read_text(path, decode(path, bytes)?, runs)?;
    lost.into_iter().for_each(|(_, lost)| faults.append(lost));
    if faults.is_empty() {
        return Ok(manifest);
    }
    Err(faults.of(path, Source::new(&manifest.source)))
}

/// A manifest, its faults, and the faults of each analysis that refers to something it does not declare, by
/// the index of the analysis. With any fault, the manifest serves for its source only.
pub(super) type Checked = (Manifest, FaultList, Vec<(usize, FaultList)>);

/// Reads and checks the text of a manifest.
///
/// # Errors
/// Every fault of a text whose notation or format is too faulty for a check of its content.
pub(super) fn read_text(path: &str, text: &str, runs: Runs) -> Result<Checked, Faults> {
    let Document { root, repeats, syntax, broken_at } = document(text);
    if let Some(fault) = newer_format(root.get_ref()) {
        return Err(Faults::of_text(path, text, fault));
    }
    if let Some(fault) = model_file(root.get_ref(), path) {
        return Err(Faults::of_text(path, text, fault));
    }
    let mut reader = Reader { runs, ..Reader::new(text) };
    reader.folder = Path::new(path).parent().unwrap_or(Path::new("")).to_owned();
    let mut draft = reader.draft(root.get_ref());
    let mut faults = reader.faults;
    faults.append(repeats);
    let source = Source::new(text);
    if !syntax.is_empty() {
        // A syntax fault can cause missing keys, and faults on its line or after a break.
        faults.retain_off_lines_of(&syntax, &source);
        faults.retain_before(broken_at);
        faults.append(syntax);
        faults.explain(decimal_commas(text), &source);
        return Err(faults.of(path, source));
    }
    let named_runs = std::mem::take(&mut reader.named_runs);
    let manifest = complete::complete(&mut draft, path, text, &mut faults);
    let manifest = Manifest { named_runs, ..manifest };
    let (manifest, lost) = check::check(&draft, manifest, &mut faults);
    faults.explain(decimal_commas(text), &source);
    Ok((manifest, faults, lost))
}

/// The fault of a file that is a model, which a manifest names.
fn model_file(root: &DeTable<'_>, path: &str) -> Option<Fault> {
    let (roles, _) = root.get_key_value("roles")?;
    let is_model = root.contains_key("variables") && !root.contains_key("agent");
    let name = Path::new(path).file_name().unwrap_or_default().to_string_lossy();
    let help = format!(
        "a manifest names it: [environment] with family = \"declared\" and model = \"{name}\"; `jitai simulate --model {name}` \
         checks and simulates it alone"
    );
    let fault = Fault::at(roles.span().into(), "this is a model, not a manifest");
    is_model.then(|| fault.help(help))
}

/// The bytes as text, without a byte-order mark.
fn decode<'b>(path: &str, bytes: &'b [u8]) -> Result<&'b str, Faults> {
    if bytes.len() as u64 > MOST_BYTES {
        let fault = Fault::whole(format!("the file is larger than {MOST_BYTES} bytes"));
        return Err(Faults::of_file(path, fault.help("write long lists of values as ranges")));
    }
    let text = str::from_utf8(bytes).map_err(|error| {
        let offset = error.valid_up_to();
        let before = str::from_utf8(&bytes[..offset]).expect("valid up to there");
        let message = format!("not UTF-8: byte 0x{:02x} at offset {offset}", bytes[offset]);
        let fault = Fault::at(Span { start: offset, end: offset }, message);
        Faults::of_text(path, before, fault.help("save the file with the encoding UTF-8"))
    })?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    if text.trim().is_empty() {
        let fault = Fault::whole("the file is empty");
        return Err(Faults::of_file(path, fault.help("start from experiments/quickstart.toml")));
    }
    match text.find('\0') {
        None => Ok(text),
        Some(start) => {
            let message = format!("byte 0x00 at offset {start}: not a text file");
            let fault = Fault::at(Span { start, end: start + 1 }, message);
            Err(Faults::of_text(path, text, fault))
        }
    }
}
