//! Broken files: no reader panics, hangs or takes the memory, whatever bytes it is given.

#![allow(clippy::disallowed_methods)] // broken and foreign files are written as they are

use std::path::Path;

use dynocal_files::measurement::{Raster, ReadKeys, by_ending, open, recording};
use dynocal_files::table::{Cells, Column, UnitSource};
use dynocal_numerics::rng::Rng64;

/// Mutants of each format.
const MUTANTS: usize = 20_000;

/// A small record in each format that can be written, and the files of others where they are at hand.
fn originals(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let n = 40;
    let wave = |k: f64| (0..n).map(|t| (k * f64::from(t)).sin()).collect::<Vec<_>>();
    let column = |name: &str, unit: &str, v| Column {
        name: name.into(),
        unit: Some((unit.into(), UnitSource::Bracket)),
        cells: Cells::Number(v),
    };
    let raster = Raster {
        name: "fast".into(),
        time_s: (0..n).map(|t| f64::from(t) * 0.01).collect(),
        columns: vec![column("torque", "Nm", wave(0.3)), column("speed", "rpm", wave(0.1))],
    };
    let mut out = Vec::new();
    for name in ["a.csv", "a.csv.gz", "a.parquet", "a.mf4", "a.mat", "a.mlg"] {
        let path = folder.join(name);
        (by_ending(&path).and_then(|f| f.write).unwrap())(&path, std::slice::from_ref(&raster)).unwrap();
        out.push((name.to_string(), std::fs::read(&path).unwrap()));
    }
    let text = "Logger 7\nTime;b [\u{b0}C];s\n12:00:00,5;1.002,5;On\n12:00:01,0;1.003,5;Off\n";
    out.push(("dialect.csv".into(), text.into()));
    let text = "\"Speeduino\"\n#\nTime\tRPM\tFan\ns\trpm\t\n0.1\t800\tOn\nMARK 1\n0.2\t810\tOff\n";
    out.push(("log.msl".into(), text.into()));
    match std::env::var("DYNOCAL_REFERENCE_DIR") {
        Ok(dir) => {
            let short = Path::new(&dir).join("data/open_ecu/formats/short.mlg");
            out.push(("short.mlg".into(), std::fs::read(short).unwrap()));
            for name in ["tiny.mf4", "tiny.mat", "tiny_v73.mat"] {
                out.push((name.into(), std::fs::read(Path::new(&dir).join("formats").join(name)).unwrap()));
            }
        }
        Err(_) => println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set"),
    }
    out
}

/// One to four faults: bytes changed, numbers made extreme, the file cut or a piece repeated.
fn mutate(original: &[u8], rng: &mut Rng64) -> Vec<u8> {
    let mut bytes = original.to_vec();
    for _ in 0..=rng.below(4) {
        if bytes.is_empty() {
            break;
        }
        let at = rng.below(bytes.len());
        match rng.below(6) {
            0 => bytes[at] ^= 1 << rng.below(8),
            1 => bytes[at] = rng.below(256) as u8,
            2 => {
                let extreme =
                    [0, 1, u64::MAX, u64::from(u32::MAX), 1 << 31, 1 << 40, i64::MAX as u64][rng.below(7)];
                let wide = [2, 4, 8][rng.below(3)];
                bytes.iter_mut().skip(at).zip(&extreme.to_le_bytes()[..wide]).for_each(|(b, x)| *b = *x);
            }
            3 => bytes.truncate(at),
            4 => {
                let piece = bytes[at..(at + 1 + rng.below(64)).min(bytes.len())].to_vec();
                bytes.splice(at..at, piece);
            }
            _ => drop(bytes.drain(at..(at + 1 + rng.below(16)).min(bytes.len()))),
        }
    }
    bytes
}

/// Where mutants are written: in memory where the system offers that, because a disk would be asked 180 000 times.
fn scratch() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
}

/// Processor time of this thread in s: what the reader costs, whoever else uses the machine. Where the system does not
/// tell it, no time is compared.
fn busy_s() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split_whitespace().next()?.parse::<f64>().ok().map(|ns| ns * 1e-9)
}

/// Peak resident memory in MB, where the system tells it.
fn peak_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM"))?;
    line.split_whitespace().nth(1)?.parse::<f64>().ok().map(|kb| kb / 1024.0)
}

#[test]
fn no_mutant_panics_hangs_or_takes_the_memory() {
    let tmp = scratch();
    let before = peak_mb();
    for (k, (name, original)) in originals(tmp.path()).into_iter().enumerate() {
        let mut rng = Rng64::stream(20_261_122, k as u64);
        let path = tmp.path().join(format!("mutant-{name}"));
        let (mut errors, mut slowest) = (0, 0.0f64);
        for _ in 0..MUTANTS {
            let bytes = mutate(&original, &mut rng);
            std::fs::write(&path, &bytes).unwrap();
            let start = busy_s();
            let once =
                || open(&path, None, &ReadKeys::default()).and_then(|s| recording(s.as_ref()).map(|_| ()));
            let read = std::panic::catch_unwind(once);
            let took = busy_s().zip(start).map_or(0.0, |(b, a)| b - a);
            slowest = slowest.max(took);
            match read {
                Ok(Ok(())) => {}
                Ok(Err(e)) => {
                    errors += 1;
                    assert!(e.to_string().contains("mutant-"), "{name}: the message names no file: {e}");
                }
                Err(_) => {
                    let kept = std::env::temp_dir().join(format!("panic-{name}"));
                    std::fs::write(&kept, &bytes).unwrap();
                    panic!("{name}: a mutant panicked, kept as {}", kept.display());
                }
            }
        }
        println!("{name}: {MUTANTS} mutants, {errors} errors, slowest {:.0} ms", slowest * 1e3);
        assert!(errors > 0, "{name}: no mutant was noticed");
        assert!(slowest < 1.0, "{name}: a mutant took {slowest:.2} s");
    }
    if let (Some(a), Some(b)) = (before, peak_mb()) {
        println!("peak memory grew by {:.0} MB", b - a);
        assert!(b - a < 256.0, "peak memory grew by {:.0} MB", b - a);
    }
}
