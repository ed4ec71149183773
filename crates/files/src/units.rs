//! Unit names: one spelling for each unit, aliases, suffixes of column names, a table of dimensions with conversions.
//!
//! A unit that is not in the table is kept as written and compared letter by letter.

/// Normal spelling, aliases, and the suffix (without underscore) that marks it in column names.
const UNITS: &[(&str, &[&str], &[&str])] = &[
    ("-", &["", "1", "none"], &[]),
    ("s", &["sec", "seconds"], &["s"]),
    ("ms", &["msec", "milliseconds"], &["ms"]),
    ("us", &["µs", "μs", "microseconds"], &["us"]),
    ("ns", &["nanoseconds"], &["ns"]),
    ("min", &["minutes"], &[]),
    ("h", &["hours"], &[]),
    ("rpm", &["1/min", "min-1", "min^-1", "U/min", "r/min", "rev/min"], &["rpm"]),
    ("Nm", &["N m", "N*m", "N.m", "N·m"], &["nm"]),
    ("kNm", &["kN m"], &[]),
    ("lbf ft", &["lb ft", "ft lb", "lb-ft", "lbft", "ft-lb", "ft lbf", "lbf*ft", "lb*ft", "ftlb"], &["lbft"]),
    ("lbf in", &["lb in", "in lb", "lb-in", "in-lb", "in lbf"], &[]),
    ("mg", &["mg/stroke", "mg/cyc", "mg/str", "mg/hub"], &["mg"]),
    ("g", &[], &["g"]),
    ("kg", &[], &["kg"]),
    ("lb", &["lbm"], &[]),
    ("deg", &["°", "degCA", "deg CA", "°CA", "°KW", "degree"], &["deg"]),
    ("rad", &[], &["rad"]),
    ("rad/s", &[], &[]),
    ("Pa", &[], &["pa"]),
    ("hPa", &[], &["hpa"]),
    ("kPa", &[], &["kpa"]),
    ("MPa", &[], &["mpa"]),
    ("mbar", &[], &["mbar"]),
    ("bar", &[], &["bar"]),
    ("psi", &["lbf/in2", "lb/in2", "lbf/in^2", "psia"], &["psi"]),
    ("kg/h", &["kgh", "kg/hr"], &["kgh"]),
    ("g/s", &["gs"], &[]),
    ("g/h", &["g/hr"], &[]),
    ("kg/s", &[], &[]),
    ("mg/s", &[], &[]),
    ("lb/h", &["lb/hr", "pph"], &[]),
    ("km/h", &["kph", "kmh"], &["kmh"]),
    ("m/s", &["mps"], &["mps"]),
    ("mph", &["mi/h"], &["mph"]),
    // Exactly, so that no other case of `kN` is taken for knots or the other way round.
    ("kn", &["knot", "knots"], &[]),
    ("K", &["kelvin"], &["k"]),
    ("degC", &["°C", "C", "deg C", "celsius", "grad C"], &["degc"]),
    ("degF", &["°F", "F", "deg F", "fahrenheit"], &["degf"]),
    ("%", &["percent", "pct"], &["pct", "percent"]),
    ("ppm", &[], &["ppm"]),
    ("V", &["volt"], &["v"]),
    ("mV", &[], &["mv"]),
    ("A", &[], &["a"]),
    ("mA", &[], &["ma"]),
    ("Hz", &[], &["hz"]),
    ("kHz", &[], &["khz"]),
    ("N", &[], &["n"]),
    ("kN", &[], &["kn"]),
    ("W", &[], &["w"]),
    ("kW", &[], &["kw"]),
    ("hp", &["bhp"], &["hp"]),
    ("PS", &["metric hp"], &[]),
    ("J", &[], &[]),
    ("kJ", &[], &[]),
    ("m", &[], &["m"]),
    ("mm", &[], &["mm"]),
    ("g/kWh", &["g/kW h", "g/(kW h)"], &["gkwh"]),
    ("kg/m3", &["kg/m^3", "kg/m³"], &[]),
    ("m3/h", &["m^3/h", "m³/h"], &[]),
    ("l/h", &["L/h"], &[]),
];

/// A unit within its dimension: value in the base unit = (value + zero) * numerator / denominator.
///
/// Two whole numbers instead of one factor, so that a conversion is rounded once: m/s to km/h is 3.6 to the last bit.
struct Scale {
    unit: &'static str,
    dimension: &'static str,
    numerator: f64,
    denominator: f64,
    zero: f64,
}

const fn row(unit: &'static str, dimension: &'static str, numerator: f64, denominator: f64) -> Scale {
    Scale { unit, dimension, numerator, denominator, zero: 0.0 }
}

/// Exact by definition of the units (international pound, foot, inch and mile; standard gravity in lbf and PS).
const SCALES: &[Scale] = &[
    row("s", "time", 1.0, 1.0),
    row("ms", "time", 1.0, 1e3),
    row("us", "time", 1.0, 1e6),
    row("ns", "time", 1.0, 1e9),
    row("min", "time", 60.0, 1.0),
    row("h", "time", 3600.0, 1.0),
    row("rpm", "rotational speed", 2.0 * std::f64::consts::PI, 60.0),
    row("rad/s", "rotational speed", 1.0, 1.0),
    row("Nm", "torque", 1.0, 1.0),
    row("kNm", "torque", 1e3, 1.0),
    row("lbf ft", "torque", 13_558_179_483_314_004.0, 1e16),
    row("lbf in", "torque", 13_558_179_483_314_004.0, 12e16),
    row("mg", "mass", 1.0, 1e6),
    row("g", "mass", 1.0, 1e3),
    row("kg", "mass", 1.0, 1.0),
    row("lb", "mass", 45_359_237.0, 1e8),
    row("deg", "angle", std::f64::consts::PI, 180.0),
    row("rad", "angle", 1.0, 1.0),
    row("Pa", "pressure", 1.0, 1.0),
    row("hPa", "pressure", 100.0, 1.0),
    row("kPa", "pressure", 1e3, 1.0),
    row("MPa", "pressure", 1e6, 1.0),
    row("mbar", "pressure", 100.0, 1.0),
    row("bar", "pressure", 1e5, 1.0),
    row("psi", "pressure", 44_482_216_152_605.0, 6_451_600_000.0),
    row("kg/h", "mass flow", 1.0, 3600.0),
    row("g/s", "mass flow", 1.0, 1e3),
    row("g/h", "mass flow", 1.0, 3.6e6),
    row("kg/s", "mass flow", 1.0, 1.0),
    row("mg/s", "mass flow", 1.0, 1e6),
    row("lb/h", "mass flow", 45_359_237.0, 3600e8),
    row("km/h", "speed", 1e3, 3600.0),
    row("m/s", "speed", 1.0, 1.0),
    row("mph", "speed", 1609.344, 3600.0),
    row("kn", "speed", 1852.0, 3600.0),
    row("K", "temperature", 1.0, 1.0),
    Scale { unit: "degC", dimension: "temperature", numerator: 1.0, denominator: 1.0, zero: 273.15 },
    Scale { unit: "degF", dimension: "temperature", numerator: 5.0, denominator: 9.0, zero: 459.67 },
    row("-", "ratio", 1.0, 1.0),
    row("%", "ratio", 1.0, 100.0),
    row("ppm", "ratio", 1.0, 1e6),
    row("V", "voltage", 1.0, 1.0),
    row("mV", "voltage", 1.0, 1e3),
    row("A", "current", 1.0, 1.0),
    row("mA", "current", 1.0, 1e3),
    row("Hz", "frequency", 1.0, 1.0),
    row("kHz", "frequency", 1e3, 1.0),
    row("N", "force", 1.0, 1.0),
    row("kN", "force", 1e3, 1.0),
    row("W", "power", 1.0, 1.0),
    row("kW", "power", 1e3, 1.0),
    row("hp", "power", 745_699_871_582_270.2, 1e12),
    row("PS", "power", 735.49875, 1.0),
    row("J", "energy", 1.0, 1.0),
    row("kJ", "energy", 1e3, 1.0),
    row("m", "length", 1.0, 1.0),
    row("mm", "length", 1.0, 1e3),
    row("m3/h", "volume flow", 1.0, 1.0),
    row("l/h", "volume flow", 1.0, 1e3),
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

/// The unit that the last part of a column name stands for: `torque_nm` gives `Nm`, `flow_g_s` gives `g/s`. What may be the
/// second half of another unit stands for none: `flow_cc_s` is no time.
///
/// ```
/// use dynocal_files::units::from_suffix;
/// assert_eq!((from_suffix("torque_nm"), from_suffix("t_ms")), (Some("Nm"), Some("ms")));
/// assert_eq!((from_suffix("air_flow_g_s"), from_suffix("fuel_flow_cc_s")), (Some("g/s"), None));
/// ```
pub fn from_suffix(name: &str) -> Option<&'static str> {
    let (stem, suffix) = name.rsplit_once('_')?;
    if stem.is_empty() {
        return None;
    }
    let unit = UNITS.iter().find(|(_, _, s)| s.contains(&suffix)).map(|(n, _, _)| *n)?;
    let halves = stem.rsplit_once('_').filter(|(head, _)| !head.is_empty());
    if let (Some("time" | "length"), Some((_, before))) = (dimension(unit), halves) {
        let known = |u: &str| UNITS.iter().find(|(n, a, _)| *n == u || a.contains(&u)).map(|r| r.0);
        let whole = known(&format!("{before}/{unit}"));
        if whole.is_some() || before.len() <= 2 || known(before).is_some() {
            return whole;
        }
    }
    Some(unit)
}

fn scale_of(unit: &str) -> Option<&'static Scale> {
    let unit = normalise(unit);
    SCALES.iter().find(|s| s.unit == unit)
}

/// Physical dimension of a unit, `None` for one that is not in the table.
///
/// ```
/// use dynocal_files::units::dimension;
/// assert_eq!(dimension("lb ft"), dimension("Nm"));
/// assert_eq!(dimension("furlong"), None);
/// ```
pub fn dimension(unit: &str) -> Option<&'static str> {
    scale_of(unit).map(|s| s.dimension)
}

/// Scale and offset from one unit to another, `to = from * scale + offset`; `None` across dimensions and for units that
/// are not in the table.
///
/// ```
/// use dynocal_files::units::conversion;
/// assert_eq!(conversion("m/s", "km/h"), Some((3.6, 0.0)));
/// assert_eq!(conversion("lb ft", "Nm"), Some((1.3558179483314004, 0.0)));
/// assert_eq!(conversion("rpm", "Nm"), None);
/// ```
pub fn conversion(from: &str, to: &str) -> Option<(f64, f64)> {
    if normalise(from) == normalise(to) {
        return Some((1.0, 0.0));
    }
    let (f, t) = (scale_of(from)?, scale_of(to)?);
    if f.dimension != t.dimension {
        return None;
    }
    let (above, below) = (f.numerator * t.denominator, f.denominator * t.numerator);
    let offset = if f.zero == 0.0 && t.zero == 0.0 { 0.0 } else { f.zero * above / below - t.zero };
    Some((above / below, offset))
}

/// Whether `text` is the name or an alias of a unit in the table (a row of units in a file is told by this).
pub fn is_known(text: &str) -> bool {
    let text = text.trim();
    UNITS.iter().any(|(n, a, _)| {
        n.eq_ignore_ascii_case(text) || a.iter().any(|x| !x.is_empty() && x.eq_ignore_ascii_case(text))
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
