//! Writing of MLVLG version 2.

use std::io::Write;
use std::path::Path;

use super::mlg::{MAGIC, Raw, TICK_S};
use crate::atomic;
use crate::error::FilesError;
use crate::measurement::Raster;
use crate::table::Cells;

/// A field with its values.
#[derive(Clone, Debug, PartialEq)]
pub struct Written {
    /// Name, at most 33 bytes.
    pub name: String,
    /// Unit, at most 9 bytes.
    pub unit: String,
    /// How it is stored; what does not fit an integer is cut to its range.
    pub raw: Raw,
    /// `value = raw scale`.
    pub scale: f64,
    /// Decimals that a tool shows.
    pub digits: u8,
    /// Values.
    pub values: Vec<f64>,
}

/// Writes a log: `time_s` of each record, the fields, and the tune (`.msq`) that it carries.
///
/// # Errors
/// [`FilesError::Write`]; also where a name is too long, or a field has not as many values as there are records.
pub fn write(path: &Path, time_s: &[f64], fields: &[Written], tune: Option<&[u8]>) -> Result<(), FilesError> {
    if let Some(reason) = unfit(time_s, fields) {
        return Err(FilesError::Write { path: path.display().to_string(), reason });
    }
    let mut text = b"\"written by dynocal\"\n".to_vec();
    if let Some(tune) = tune {
        let head = "NEW_INFO_PROVIDER,LogStart_MAIN_TUNE,Type:msqVisible:falseLength:";
        text.extend_from_slice(format!("\n{head}{}\n", tune.len()).as_bytes());
        text.extend_from_slice(tune);
    }
    text.push(0);
    let start = 24 + 89 * fields.len();
    let bytes: usize = fields.iter().map(|f| f.raw.bytes()).sum();
    atomic::write_with(path, |w| {
        w.write_all(MAGIC)?;
        w.write_all(&2i16.to_be_bytes())?;
        w.write_all(&0i32.to_be_bytes())?;
        w.write_all(&(start as i32).to_be_bytes())?;
        w.write_all(&((start + text.len()) as i32).to_be_bytes())?;
        w.write_all(&(bytes as i16).to_be_bytes())?;
        w.write_all(&(fields.len() as i16).to_be_bytes())?;
        fields.iter().try_for_each(|f| w.write_all(&head(f)))?;
        w.write_all(&text)?;
        (0..time_s.len()).try_for_each(|k| record(w, k, time_s[k], fields))
    })
}

fn unfit(time_s: &[f64], fields: &[Written]) -> Option<String> {
    if fields.is_empty() || fields.len() > 700 {
        return Some(format!("found {} fields, expected 1 to 700 for a log", fields.len()));
    }
    if !time_s.windows(2).all(|w| w[1] > w[0]) {
        return Some("its stamps do not increase".into());
    }
    fields.iter().find_map(|f| {
        if f.name.len() > 33 || f.unit.len() > 9 {
            return Some(format!("`{}` [{}]: a name has at most 33 bytes and a unit 9", f.name, f.unit));
        }
        let same = f.values.len() == time_s.len();
        (!same).then(|| format!("`{}` has {} values for {} records", f.name, f.values.len(), time_s.len()))
    })
}

fn head(f: &Written) -> [u8; 89] {
    let mut b = [0u8; 89];
    b[0] = match f.raw {
        Raw::Unsigned(1) => 0,
        Raw::Signed(1) => 1,
        Raw::Unsigned(2) => 2,
        Raw::Signed(2) => 3,
        Raw::Unsigned(_) => 4,
        Raw::Signed(4) => 5,
        Raw::Signed(_) => 6,
        Raw::Float => 7,
    };
    let latin = |text: &str| text.chars().map(|c| u8::try_from(c).unwrap_or(b'?')).collect::<Vec<u8>>();
    b[1..35].iter_mut().zip(latin(&f.name)).for_each(|(a, c)| *a = c);
    b[35..45].iter_mut().zip(latin(&f.unit)).for_each(|(a, c)| *a = c);
    b[46..50].copy_from_slice(&(f.scale as f32).to_be_bytes());
    b[54] = f.digits;
    b
}

fn record(w: &mut dyn Write, k: usize, time_s: f64, fields: &[Written]) -> std::io::Result<()> {
    let ticks = ((time_s / TICK_S).round() as i64 & 0xffff) as u16;
    w.write_all(&[0, (k & 0xff) as u8])?;
    w.write_all(&ticks.to_be_bytes())?;
    let mut sum = 0u8;
    for f in fields {
        let wide = raw(f, f.values[k]);
        let bytes = &wide[8 - f.raw.bytes()..];
        sum = bytes.iter().fold(sum, |s, b| s.wrapping_add(*b));
        w.write_all(bytes)?;
    }
    w.write_all(&[sum])
}

/// The raw value in the last bytes.
fn raw(f: &Written, value: f64) -> [u8; 8] {
    let count = (value / f.scale).round();
    match f.raw {
        Raw::Float => u64::from(((value / f.scale) as f32).to_bits()).to_be_bytes(),
        Raw::Unsigned(n) => (count.clamp(0.0, 2f64.powi(8 * n as i32) - 1.0) as u64).to_be_bytes(),
        Raw::Signed(n) => {
            let half = 2f64.powi(8 * n as i32 - 1);
            (count.clamp(-half, half - 1.0) as i64).to_be_bytes()
        }
    }
}

/// One raster in single precision; text has no place in this format.
pub(super) fn write_raster(path: &Path, rasters: &[Raster]) -> Result<(), FilesError> {
    let fail = |reason: &str| FilesError::Write { path: path.display().to_string(), reason: reason.into() };
    let [raster] = rasters else { return Err(fail("an .mlg file holds one raster")) };
    let start = raster.time_s.first().copied().unwrap_or(0.0);
    let float = |name: &str, unit: &str, digits: u8, values: Vec<f64>| Written {
        name: name.into(),
        unit: unit.into(),
        raw: Raw::Float,
        scale: 1.0,
        digits,
        values,
    };
    // The field `Time` tells gaps that are longer than the ticks can say.
    let mut fields = vec![float("Time", "s", 3, raster.time_s.clone())];
    for c in &raster.columns {
        let Cells::Number(values) = &c.cells else {
            return Err(fail(&format!("`{}` holds words, and an .mlg file holds numbers", c.name)));
        };
        fields.push(float(&c.name, c.unit.as_ref().map_or("", |u| u.0.as_str()), 3, values.clone()));
    }
    let time_s: Vec<f64> = raster.time_s.iter().map(|t| t - start).collect();
    write(path, &time_s, &fields, None)
}
