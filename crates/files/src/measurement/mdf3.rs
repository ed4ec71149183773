//! MDF 3 (`.dat`, `.mdf`) by `falcon_mdf`, read group by group.

use std::path::Path;

use dynocal_numerics::registry::MemberDoc;
use falcon_mdf::SignalValues;
use falcon_mdf::mdf3::Mdf3File;

use crate::error::FilesError;
use crate::measurement::{ChannelInfo, GroupInfo, Reader, Source, TakeChunk};
use crate::table::Cells;
use crate::units;

/// Row of the table of formats.
pub const FORMAT: Reader = Reader {
    doc: MemberDoc { name: "mdf3", what: "MDF 3.x; one group in memory at a time", params: &[] },
    endings: &[".mdf", ".dat"],
    recognises: |head| head.starts_with(b"MDF     3") || head.starts_with(b"MDF     2"),
    open: |path, _| Ok(Box::new(Mdf3::open(path)?)),
    write: None,
    several: false,
};

struct Mdf3 {
    path: String,
    file: Mdf3File,
    groups: Vec<GroupInfo>,
    /// Data group and channel group of each group.
    places: Vec<(usize, usize)>,
}

impl Mdf3 {
    fn open(path: &Path) -> Result<Self, FilesError> {
        let name = path.display().to_string();
        let file = Mdf3File::open(path).map_err(|e| malformed(&name, &e))?;
        let (mut groups, mut places) = (Vec::new(), Vec::new());
        for (d, data) in file.data_groups().iter().enumerate() {
            for (g, group) in data.channel_groups.iter().enumerate() {
                let channels = group.channels.iter().map(|c| ChannelInfo {
                    name: c.name.clone(),
                    unit: match c.unit.trim() {
                        "" if c.is_time() => Some("s".into()),
                        "" => None,
                        // The text of MDF 3 is Latin-1, whose degree sign the library gives as a replacement.
                        u => Some(units::normalise(&u.replace('\u{fffd}', "\u{b0}"))),
                    },
                    comment: c.description.trim().to_string(),
                    text: false,
                });
                groups.push(GroupInfo {
                    name: group.comment.trim().to_string(),
                    channels: channels.collect(),
                    time: group.channels.iter().position(|c| c.is_time()),
                    rows: u64::from(group.cycle_count),
                });
                places.push((d, g));
            }
        }
        Ok(Self { path: name, file, groups, places })
    }
}

fn malformed(path: &str, e: &dyn std::fmt::Display) -> FilesError {
    FilesError::Malformed { path: path.into(), format: "MDF 3", reason: e.to_string() }
}

impl Source for Mdf3 {
    fn file(&self) -> &str {
        &self.path
    }

    fn groups(&self) -> &[GroupInfo] {
        &self.groups
    }

    fn notes(&self) -> &[String] {
        &[]
    }

    fn chunks(&self, group: usize, channels: &[usize], take: &mut TakeChunk<'_>) -> Result<(), FilesError> {
        let (d, g) = self.places[group];
        let read = |c: &usize| -> Result<Cells, FilesError> {
            let values = self.file.channel_physical(d, g, *c).map_err(|e| malformed(&self.path, &e))?;
            Ok(match values {
                SignalValues::Str(text) => Cells::Text(text),
                other => Cells::Number(other.to_f64()),
            })
        };
        take(&channels.iter().map(read).collect::<Result<Vec<_>, _>>()?)
    }
}
