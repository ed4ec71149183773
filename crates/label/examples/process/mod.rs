//! What a process has used so far, as Linux tells it.

use std::error::Error;

/// User and system time of the process in s.
pub(crate) fn cpu_s() -> Result<f64, Box<dyn Error>> {
    let stat = std::fs::read_to_string("/proc/self/stat")?;
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks = |k: usize| -> Result<f64, Box<dyn Error>> {
        Ok(after_name.split_whitespace().nth(k).ok_or("short /proc/self/stat")?.parse()?)
    };
    Ok((ticks(11)? + ticks(12)?) / 100.0)
}

/// Most memory that the process has held so far, in GiB.
pub(crate) fn peak_gib() -> Result<f64, Box<dyn Error>> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:")).ok_or("no VmHWM")?;
    let kib: f64 = line.split_whitespace().nth(1).ok_or("no number in VmHWM")?.parse()?;
    Ok(kib / 1048576.0)
}
