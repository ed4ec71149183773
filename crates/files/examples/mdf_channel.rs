//! Mean and range of one channel of a measurement file, read in pieces: `mdf_channel FILE CHANNEL` (for the comparison with
//! asammdf in `bench/peers/mdf_stream.py`).

use std::path::PathBuf;

use dynocal_files::FilesError;
use dynocal_files::measurement::{ReadKeys, open};
use dynocal_files::table::Cells;

fn main() -> Result<(), FilesError> {
    let mut arguments = std::env::args().skip(1);
    let path = PathBuf::from(arguments.next().unwrap_or_default());
    let name = arguments.next().unwrap_or_default();
    let source = open(&path, None, &ReadKeys::default())?;
    for (g, group) in source.groups().iter().enumerate() {
        let Some(c) = group.channels.iter().position(|c| c.name == name) else { continue };
        let (mut rows, mut sum, mut low, mut high) = (0u64, 0.0, f64::INFINITY, f64::NEG_INFINITY);
        source.chunks(g, &[c], &mut |chunk| {
            if let Cells::Number(v) = &chunk[0] {
                rows += v.len() as u64;
                v.iter().for_each(|x| (sum, low, high) = (sum + x, low.min(*x), high.max(*x)));
            }
            Ok(())
        })?;
        println!("{name}: {rows} rows, mean {}, {low} to {high}", sum / rows as f64);
    }
    // Peak memory as the system tells it.
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    if let Some(line) = status.lines().find(|l| l.starts_with("VmHWM")) {
        println!("{line}");
    }
    Ok(())
}
