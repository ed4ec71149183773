//! Parquet files that say more than numbers: the unit of time stamps, checksums of pages, names.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use dynocal_files::dataset::{ChannelSpec, Layout, Missing, Select, Time, datasets, read_table};
use dynocal_files::{FilesError, atomic};
use dynocal_ident::data::Role;
use parquet::basic::{LogicalType, Repetition, TimeUnit, Type as Physical};
use parquet::data_type::{DoubleType, Int64Type};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;

fn checked_pages() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/reference/checked_pages.parquet")
}

/// A file with a column `t` of `type_of_t` and channels of these names.
fn written(path: &Path, type_of_t: Option<LogicalType>, t: &[i64], names: &[&str]) {
    let required = |name: &str, physical, logical| {
        Type::primitive_type_builder(name, physical)
            .with_repetition(Repetition::REQUIRED)
            .with_logical_type(logical)
            .build()
            .map(Arc::new)
            .unwrap()
    };
    let mut fields = vec![required("t", Physical::INT64, type_of_t)];
    fields.extend(names.iter().map(|n| required(n, Physical::DOUBLE, None)));
    let schema = Type::group_type_builder("schema").with_fields(fields).build().unwrap();
    let properties = Arc::new(WriterProperties::builder().build());
    let mut writer = SerializedFileWriter::new(Vec::new(), Arc::new(schema), properties).unwrap();
    let mut group = writer.next_row_group().unwrap();
    let mut column = group.next_column().unwrap().unwrap();
    column.typed::<Int64Type>().write_batch(t, None, None).unwrap();
    column.close().unwrap();
    for _ in names {
        let mut column = group.next_column().unwrap().unwrap();
        column.typed::<DoubleType>().write_batch(&vec![1.0; t.len()], None, None).unwrap();
        column.close().unwrap();
    }
    group.close().unwrap();
    atomic::write(path, &writer.into_inner().unwrap()).unwrap();
}

fn sample_time_s(path: &Path) -> Result<f64, FilesError> {
    let table = read_table(path, None)?;
    let channels = vec![ChannelSpec {
        column: "u".into(),
        name: "u".into(),
        unit: Some("-".into()),
        convert: false,
        role: Role::Input,
    }];
    let time = Time::Column { column: "t".into(), unit: None };
    let layout =
        Layout { channels, time, trajectory: None, init_samples: 0, missing: Missing::Refuse, cut: None };
    Ok(datasets(&table, &layout, &Select::All)?[0].sample_time_s)
}

/// The unit of a time stamp stands in its type: 20 ms are 0.02 s whether they are counted in ms, us or ns, and the digits are
/// those of the stamps, not of seconds since 1970. Whole numbers without a type have no unit.
#[test]
fn time_stamps_keep_their_unit() {
    let tmp = tempfile::tempdir().unwrap();
    let path = tmp.path().join("bed.parquet");
    for (unit, per_second) in
        [(TimeUnit::MILLIS, 1_000i64), (TimeUnit::MICROS, 1_000_000), (TimeUnit::NANOS, 1_000_000_000)]
    {
        let t: Vec<i64> = (0..100).map(|k| 1_700_000_000 * per_second + k * per_second / 50).collect();
        for typed in [LogicalType::timestamp(true, unit), LogicalType::timestamp(false, unit)] {
            written(&path, Some(typed), &t, &["u"]);
            assert_eq!(sample_time_s(&path).unwrap(), 0.02, "{unit:?}");
            let table = read_table(&path, None).unwrap();
            let expected: Vec<f64> =
                (0..100).map(|k| (k * per_second / 50) as f64 / per_second as f64).collect();
            assert_eq!(table.numbers("t", 0, 100).unwrap(), expected, "{unit:?}");
            assert!(table.notes[0].contains("`t`: time stamps in"), "{:?}", table.notes);
        }
        // A clock in ms has 32 bits.
        if unit != TimeUnit::MILLIS {
            let clock: Vec<i64> = t.iter().map(|v| v % (3600 * per_second)).collect();
            written(&path, Some(LogicalType::time(false, unit)), &clock, &["u"]);
            assert_eq!(sample_time_s(&path).unwrap(), 0.02, "{unit:?}");
        }
    }
    written(&path, None, &[0, 20, 40], &["u"]);
    let e = sample_time_s(&path).unwrap_err();
    assert!(matches!(&e, FilesError::NoTimeUnit { column, .. } if column == "t"), "{e}");
}

#[test]
fn a_name_that_stands_twice_is_refused() {
    let tmp = tempfile::tempdir().unwrap();
    let path = tmp.path().join("bed.parquet");
    // The unit is no part of the name.
    for names in [&["u", "u"][..], &["u [mg]", "u [g]"], &["u", "t"]] {
        written(&path, None, &[0, 1, 2], names);
        let e = read_table(&path, None).unwrap_err();
        assert!(matches!(&e, FilesError::DuplicateColumn { .. }), "{names:?}: {e}");
    }
}

/// One bit of the values of a page: without the checksum it would be another number.
#[test]
fn pages_are_checked() {
    let bytes = std::fs::read(checked_pages()).unwrap();
    let table = read_table(&checked_pages(), None).unwrap();
    assert_eq!((sample_time_s_of(&table), table.rows()), (0.02, 40));
    assert_eq!(table.numbers("u", 3, 4).unwrap(), [1.5]);
    let place = bytes.windows(8).position(|w| w == 1.5f64.to_le_bytes()).unwrap();
    let tmp = tempfile::tempdir().unwrap();
    let path = tmp.path().join("flipped.parquet");
    let mut flipped = bytes;
    flipped[place + 6] ^= 1;
    atomic::write(&path, &flipped).unwrap();
    let e = read_table(&path, None).unwrap_err().to_string();
    assert!(e.contains("flipped.parquet") && e.to_lowercase().contains("checksum"), "{e}");
}

fn sample_time_s_of(table: &dynocal_files::table::Table) -> f64 {
    table.numbers("t", 0, 2).unwrap()[1]
}
