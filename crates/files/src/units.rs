//! Unit names: one spelling for each unit, aliases, suffixes of column names, exact conversions.
//!
//! A unit that is not in the table is kept as written and compared letter by letter.

/// Normal spelling, aliases, and the suffix (without underscore) that marks it in column names.
const UNITS: &[(&str, &[&str], &[&str])] = &[
    ("-", &["", "1", "none"], &[]),
    ("s", &["sec", "seconds"], &["s"]),
    ("ms", &["msec", "milliseconds"], &["ms"]),
    ("min", &["minutes"], &[]),
    ("h", &["hours"], &[]),
    ("rpm", &["1/min", "min-1", "min^-1", "U/min", "r/min", "rev/min"], &["rpm"]),
    ("Nm", &["N m", "N*m", "N.m"], &["nm"]),
    ("mg", &["mg/stroke", "mg/cyc", "mg/str"], &["mg"]),
    ("g", &[], &["g"]),
    ("kg", &[], &["kg"]),
    ("deg", &["°", "degCA", "deg CA", "°CA", "°KW", "degree"], &["deg"]),
    ("rad", &[], &["rad"]),
    ("rad/s", &[], &[]),
    ("Pa", &[], &["pa"]),
    ("hPa", &[], &["hpa"]),
    ("kPa", &[], &["kpa"]),
    ("mbar", &[], &["mbar"]),
    ("bar", &[], &["bar"]),
    ("psi", &["lbf/in2", "lb/in2"], &["psi"]),
    ("kg/h", &["kgh"], &["kgh"]),
    ("g/s", &["gs"], &[]),
    ("kg/s", &[], &[]),
    ("km/h", &["kph", "kmh"], &["kmh"]),
    ("m/s", &["mps"], &["mps"]),
    ("K", &["kelvin"], &["k"]),
    ("degC", &["°C", "C", "deg C", "celsius"], &["degc"]),
    ("%", &["percent", "pct"], &["pct", "percent"]),
    ("V", &["volt"], &["v"]),
    ("mV", &[], &["mv"]),
    ("A", &[], &["a"]),
    ("Hz", &[], &["hz"]),
    ("N", &[], &["n"]),
    ("W", &[], &["w"]),
    ("kW", &[], &["kw"]),
    ("J", &[], &[]),
    ("m", &[], &["m"]),
    ("mm", &[], &["mm"]),
    ("ppm", &[], &["ppm"]),
];

/// (from, to, scale, offset): value in `to` = value in `from` * scale + offset, exact by definition of the units.
const CONVERSIONS: &[(&str, &str, f64, f64)] = &[
    ("ms", "s", 1e-3, 0.0),
    ("min", "s", 60.0, 0.0),
    ("h", "s", 3600.0, 0.0),
    ("g", "mg", 1e3, 0.0),
    ("kg", "g", 1e3, 0.0),
    ("kg", "mg", 1e6, 0.0),
    ("Pa", "kPa", 1e-3, 0.0),
    ("hPa", "kPa", 0.1, 0.0),
    ("mbar", "kPa", 0.1, 0.0),
    ("bar", "kPa", 100.0, 0.0),
    // Pound-force (0.45359237 kg under 9.80665 m/s2) per square inch (0.0254 m).
    ("psi", "kPa", 0.45359237 * 9.80665 / (0.0254 * 0.0254) * 1e-3, 0.0),
    ("g/s", "kg/h", 3.6, 0.0),
    ("kg/s", "kg/h", 3600.0, 0.0),
    ("m/s", "km/h", 3.6, 0.0),
    ("degC", "K", 1.0, 273.15),
    ("mV", "V", 1e-3, 0.0),
    ("W", "kW", 1e-3, 0.0),
    ("mm", "m", 1e-3, 0.0),
];

/// The normal spelling of `unit`; unknown units are kept (trimmed).
///
/// ```
/// assert_eq!(dynocal_files::units::normalise("1/min"), "rpm");
/// assert_eq!(dynocal_files::units::normalise("furlong"), "furlong");
/// ```
pub fn normalise(unit: &str) -> String {
    let unit = unit.trim();
    let known = UNITS.iter().find(|(n, a, _)| *n == unit || a.contains(&unit));
    // Case only matters where it distinguishes units (mg, Mg): an exact match wins, then one without case.
    let known = known.or_else(|| {
        let mut hits = UNITS.iter().filter(|(n, a, _)| {
            n.eq_ignore_ascii_case(unit) || a.iter().any(|x| x.eq_ignore_ascii_case(unit))
        });
        let first = hits.next();
        if hits.next().is_some() { None } else { first }
    });
    known.map_or_else(|| unit.to_string(), |(n, _, _)| (*n).to_string())
}

/// The unit that the last part of a column name stands for: `torque_nm` gives `Nm`.
pub fn from_suffix(name: &str) -> Option<&'static str> {
    let (stem, suffix) = name.rsplit_once('_')?;
    if stem.is_empty() {
        return None;
    }
    UNITS.iter().find(|(_, _, s)| s.contains(&suffix)).map(|(n, _, _)| *n)
}

/// Scale and offset from one unit to another: `to = from * scale + offset`; `None` where there is no exact one.
pub fn conversion(from: &str, to: &str) -> Option<(f64, f64)> {
    let (from, to) = (normalise(from), normalise(to));
    if from == to {
        return Some((1.0, 0.0));
    }
    CONVERSIONS.iter().find_map(|(f, t, k, o)| {
        if *f == from && *t == to {
            Some((*k, *o))
        } else if *f == to && *t == from {
            Some((1.0 / k, -o / k))
        } else {
            None
        }
    })
}

/// Unit at the end of a column name in parentheses, `Boost (PSI)`, where it is a unit of the table: parentheses may hold
/// anything else too. The name stays whole.
///
/// ```
/// use dynocal_files::units::from_parentheses;
/// assert_eq!(from_parentheses("Boost (PSI)").as_deref(), Some("psi"));
/// assert_eq!(from_parentheses("Lambda (bank 1)"), None);
/// ```
pub fn from_parentheses(name: &str) -> Option<String> {
    let (_, inside) = name.trim().strip_suffix(')')?.rsplit_once('(')?;
    let unit = normalise(inside);
    (!inside.trim().is_empty() && UNITS.iter().any(|u| u.0 == unit && u.0 != "-")).then_some(unit)
}

/// Splits a header cell `name [unit]` into name and unit.
pub fn split_header(cell: &str) -> (String, Option<String>) {
    let cell = cell.trim();
    if let Some(rest) = cell.strip_suffix(']')
        && let Some((name, unit)) = rest.rsplit_once('[')
        && !name.trim().is_empty()
    {
        return (name.trim().to_string(), Some(normalise(unit)));
    }
    (cell.to_string(), None)
}
