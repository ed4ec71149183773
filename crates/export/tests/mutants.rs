//! Broken delivery files: no reader panics, hangs or takes the memory.

#![allow(clippy::disallowed_methods)] // files of tests are written as they are

mod common;

use dynocal_export::format::{Keys, read, write};
use dynocal_numerics::rng::Rng64;

const MUTANTS: usize = 20_000;

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
            // A number that is too large, in words.
            2 => drop(bytes.splice(at..at, *b"99999999999")),
            3 => bytes.truncate(at),
            4 => {
                let piece = bytes[at..(at + 1 + rng.below(200)).min(bytes.len())].to_vec();
                bytes.splice(at..at, piece);
            }
            _ => drop(bytes.drain(at..(at + 1 + rng.below(16)).min(bytes.len()))),
        }
    }
    bytes
}

/// Processor time of this thread in s: what the reader costs, whoever else uses the machine. Where the system does not
/// tell it, no time is compared.
fn busy_s() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split_whitespace().next()?.parse::<f64>().ok().map(|ns| ns * 1e-9)
}

fn peak_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM"))?;
    line.split_whitespace().nth(1)?.parse::<f64>().ok().map(|kb| kb / 1024.0)
}

#[test]
fn no_mutant_panics_hangs_or_takes_the_memory() {
    let before = peak_mb();
    for (k, format) in ["dcm", "cdfx", "csv", "json", "a2l"].into_iter().enumerate() {
        let package = if format == "json" { common::dynamic_map() } else { common::maps() };
        let files = write(&package, format, &Keys::default()).unwrap();
        let file = &files[files.len() - 1];
        let mut rng = Rng64::stream(20_261_122, k as u64);
        let (mut errors, mut slowest) = (0, 0.0f64);
        for _ in 0..MUTANTS {
            let bytes = mutate(&file.bytes, &mut rng);
            let start = busy_s();
            let once = || match format {
                "a2l" => dynocal_export::format::a2l::read(&file.name, &bytes).map(|_| ()),
                _ => read(&file.name, &bytes).map(|_| ()),
            };
            let result = std::panic::catch_unwind(once);
            let took = busy_s().zip(start).map_or(0.0, |(b, a)| b - a);
            slowest = slowest.max(took);
            match result {
                Ok(Ok(())) => {}
                Ok(Err(e)) => {
                    errors += 1;
                    assert!(e.to_string().contains(&file.name), "{format}: the message names no file: {e}");
                }
                Err(_) => {
                    let kept = std::env::temp_dir().join(format!("panic-{}", file.name));
                    std::fs::write(&kept, &bytes).unwrap();
                    panic!("{format}: a mutant panicked, kept as {}", kept.display());
                }
            }
        }
        println!("{format}: {MUTANTS} mutants, {errors} errors, slowest {:.0} ms", slowest * 1e3);
        assert!(errors > 0, "{format}: no mutant was noticed");
        assert!(slowest < 1.0, "{format}: a mutant took {slowest:.2} s");
    }
    if let (Some(a), Some(b)) = (before, peak_mb()) {
        println!("peak memory grew by {:.0} MB", b - a);
        assert!(b - a < 256.0, "peak memory grew by {:.0} MB", b - a);
    }
}
