//! CDF 2.0 (`.cdfx`), ASAM's XML of calibration data, written to its schema.

use std::fmt::Write;

use dynocal_numerics::registry::MemberDoc;

use crate::characteristic::{Characteristic, identifier};
use crate::error::ExportError;
use crate::format::cdfx_read::read;
use crate::format::{Export, Holds, OutFile};
use crate::package::Package;

/// Row of the table of exports.
pub const EXPORT: Export = Export {
    doc: MemberDoc {
        name: "cdfx",
        what: "ASAM CDF 2.0: scalars, blocks, curves, maps, shared axes",
        params: &[],
    },
    holds: &[Holds::Characteristics],
    ecu_names: true,
    write: |package, _| {
        Ok(vec![OutFile {
            name: format!("{}.cdfx", identifier(&package.name)),
            bytes: text(package)?.into_bytes(),
        }])
    },
    read: Some((".cdfx", read)),
};

/// Text of an element.
pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

fn values(v: &[f64]) -> String {
    v.iter().map(|x| format!("<V>{x:?}</V>")).collect()
}

fn text(package: &Package) -> Result<String, ExportError> {
    let name = identifier(&package.name);
    let mut s = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    // Two hyphens would end the comment.
    let lines: Vec<String> = package.provenance.lines().iter().map(|l| l.replace("--", "- -")).collect();
    let _ = writeln!(s, "<!-- {} -->", lines.join("\n     "));
    let _ = writeln!(
        s,
        "<!DOCTYPE MSRSW PUBLIC \"-//ASAM//DTD CALIBRATION DATA FORMAT:V2.0.0:LAI:IAI:XML:CDF200.XSD//EN\" \"cdf_v2.0.0.sl.dtd\">"
    );
    let _ = writeln!(
        s,
        "<MSRSW><SHORT-NAME>{name}</SHORT-NAME><CATEGORY>CDF20</CATEGORY><SW-SYSTEMS><SW-SYSTEM><SHORT-NAME>{name}</SHORT-NAME>"
    );
    let _ = writeln!(
        s,
        "<SW-INSTANCE-SPEC><SW-INSTANCE-TREE><SHORT-NAME>{name}</SHORT-NAME><CATEGORY>NO_VCD</CATEGORY>"
    );
    for axis in package.shared_axes()? {
        let _ = writeln!(
            s,
            "<SW-INSTANCE><SHORT-NAME>{}</SHORT-NAME><LONG-NAME>{}</LONG-NAME><CATEGORY>COM_AXIS</CATEGORY>\
<SW-FEATURE-REF>{name}</SW-FEATURE-REF><SW-VALUE-CONT><UNIT-DISPLAY-NAME>{}</UNIT-DISPLAY-NAME>\
<SW-ARRAYSIZE><V>{}</V></SW-ARRAYSIZE><SW-VALUES-PHYS>{}</SW-VALUES-PHYS></SW-VALUE-CONT></SW-INSTANCE>",
            identifier(&axis.name),
            escape(&axis.description),
            escape(&axis.unit),
            axis.points.len(),
            values(&axis.points)
        );
    }
    for c in &package.characteristics {
        instance(&mut s, c, &name)?;
    }
    s.push_str("</SW-INSTANCE-TREE></SW-INSTANCE-SPEC></SW-SYSTEM></SW-SYSTEMS></MSRSW>\n");
    Ok(s)
}

fn instance(s: &mut String, c: &Characteristic, feature: &str) -> Result<(), ExportError> {
    let category = match c.axes.len() {
        0 if c.values.len() == 1 => "VALUE",
        0 => "VAL_BLK",
        1 => "CURVE",
        2 => "MAP",
        n => {
            let reason = format!("{n} axes, expected at most 2");
            return Err(ExportError::Unfit { format: "cdfx", what: c.name.clone(), reason });
        }
    };
    let size = if category == "VAL_BLK" {
        format!("<SW-ARRAYSIZE><V>{}</V></SW-ARRAYSIZE>", c.values.len())
    } else {
        String::new()
    };
    let body = if c.axes.len() == 2 {
        c.values.chunks(c.axes[0].points.len()).map(|row| format!("<VG>{}</VG>", values(row))).collect()
    } else {
        values(&c.values)
    };
    let _ = write!(
        s,
        "<SW-INSTANCE><SHORT-NAME>{}</SHORT-NAME><LONG-NAME>{}</LONG-NAME><CATEGORY>{category}</CATEGORY>\
<SW-FEATURE-REF>{feature}</SW-FEATURE-REF><SW-VALUE-CONT><UNIT-DISPLAY-NAME>{}</UNIT-DISPLAY-NAME>{size}\
<SW-VALUES-PHYS>{body}</SW-VALUES-PHYS></SW-VALUE-CONT>",
        c.name,
        escape(&c.description),
        escape(&c.unit)
    );
    if !c.axes.is_empty() {
        s.push_str("<SW-AXIS-CONTS>");
        for axis in &c.axes {
            let _ = if axis.shared {
                write!(
                    s,
                    "<SW-AXIS-CONT><CATEGORY>COM_AXIS</CATEGORY><SW-INSTANCE-REF>{}</SW-INSTANCE-REF></SW-AXIS-CONT>",
                    identifier(&axis.name)
                )
            } else {
                write!(
                    s,
                    "<SW-AXIS-CONT><CATEGORY>STD_AXIS</CATEGORY><UNIT-DISPLAY-NAME>{}</UNIT-DISPLAY-NAME>\
<SW-VALUES-PHYS>{}</SW-VALUES-PHYS></SW-AXIS-CONT>",
                    escape(&axis.unit),
                    values(&axis.points)
                )
            };
        }
        s.push_str("</SW-AXIS-CONTS>");
    }
    s.push_str("</SW-INSTANCE>\n");
    Ok(())
}
