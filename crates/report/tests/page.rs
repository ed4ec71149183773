//! The page: escaping, structure, data, determinism, and the message of every fault.

use dynocal_report::{
    Axis, Bars, Block, Check, Column, Details, HeatMap, Panel, RenderError, Report, Role, Section, Series,
    Table, TimePlot, XyPlot, render, significant,
};

const HOSTILE: &str = "</script><b onload=\"x()\">&'";

fn with(block: impl Into<Block>) -> Report {
    Report::new("t").section(Section::new("s").block(block))
}

fn plot(time: Vec<f64>, values: Vec<f64>) -> TimePlot {
    TimePlot::new("record", time).panel(Panel::new("Torque", "Nm").line("torque", values))
}

/// The plot data of a page, read back as the page's script would.
fn data(html: &str) -> serde_json::Value {
    let start = "<script type=\"application/json\" id=\"data\">";
    let begin = html.find(start).expect("data element") + start.len();
    let end = begin + html[begin..].find("</script>").expect("end of the data element");
    serde_json::from_str(&html[begin..end]).expect("valid JSON")
}

fn message(report: &Report) -> String {
    render(report).expect_err("a fault").to_string()
}

#[test]
fn every_text_is_escaped_wherever_it_stands() {
    let section = Section::new(HOSTILE)
        .text(HOSTILE)
        .heading(HOSTILE)
        .code(HOSTILE, HOSTILE)
        .block(Table::new(vec![Column::number(HOSTILE, HOSTILE)]).caption(HOSTILE).row([HOSTILE.into()]))
        .block(Details::new(HOSTILE).block(Block::Paragraph { text: HOSTILE.into() }))
        .block(
            TimePlot::new(HOSTILE, [0.0, 1.0])
                .caption(HOSTILE)
                .mark(0.5, HOSTILE)
                .panel(Panel::new(HOSTILE, HOSTILE).line(HOSTILE, [1.0, 2.0]).level(HOSTILE, 1.0)),
        )
        .block(Bars::new(HOSTILE, Axis::new(HOSTILE, HOSTILE), [HOSTILE]).series(HOSTILE, [1.0]));
    let report = Report::new(HOSTILE)
        .subtitle(HOSTILE)
        .fact(HOSTILE, HOSTILE)
        .warning(HOSTILE)
        .check(Check::new(HOSTILE, HOSTILE).asked(HOSTILE).measured(HOSTILE).unit(HOSTILE).note(HOSTILE))
        .section(section);
    let html = render(&report).expect("a page");
    assert!(!html.contains("<b onload"), "a text became markup");
    assert_eq!(html.matches("</script>").count(), html.matches("<script").count(), "a text ended a script");
    assert_eq!(
        data(&html)[0]["panels"][0]["series"][0]["label"],
        HOSTILE,
        "the plot data keep the text as it is"
    );
}

#[test]
fn nothing_is_loaded_from_outside() {
    let html = render(&with(plot(vec![0.0, 1.0], vec![1.0, 2.0]))).expect("a page");
    assert!(html.contains("default-src 'none'"));
    assert!(!html.contains(" src="), "an element loads a file");
    assert!(!html.contains("@import") && !html.contains("url("), "the style loads a file");
    for link in html.split("<link ").skip(1) {
        assert!(link.starts_with("rel=\"icon\" href=\"data:,\""), "found a link: {}", &link[..40]);
    }
}

#[test]
fn warnings_and_checks_come_before_the_sections() {
    let report = Report::new("t")
        .warning("look out")
        .check(Check::new("a", "first").asked("<= 1.5").measured(0.25).holds(true))
        .check(Check::new("b", "second").measured(2.0).holds(false))
        .check(Check::new("c", "third").measured(f64::NAN))
        .section(Section::new("Body").text("the body"));
    let html = render(&report).expect("a page");
    let at = |text: &str| html.find(text).unwrap_or_else(|| panic!("`{text}` is missing"));
    assert!(at("look out") < at("id=\"checks\"") && at("id=\"checks\"") < at("the body"));
    assert!(html.contains("1 fails") && html.contains("1 holds") && html.contains("1 reported only"));
    assert!(html.contains(">0.25<") && html.contains("&lt;= 1.5") && html.contains(">NaN<"));
}

#[test]
fn equal_documents_give_equal_bytes_and_survive_json() {
    let report = with(plot(vec![0.0, 0.1, 0.3], vec![1.0, f64::NAN, 3.0]))
        .check(Check::new("a", "b").measured(1.0).asked("x"));
    let json = serde_json::to_string(&report).expect("JSON");
    let back: Report = serde_json::from_str(&json).expect("the same document");
    let html = render(&report).expect("a page");
    assert_eq!(html, render(&back).expect("a page"));
    assert_eq!(html, render(&report.clone()).expect("a page"));
}

#[test]
fn data_are_rounded_to_six_digits_and_gaps_stay_gaps() {
    let values = vec![1.0 / 3.0, f64::NAN, 1234.5678, 2.0, -1.0e-9 / 3.0];
    let html = render(&with(plot(vec![0.0, 0.03, 0.06, 0.09, 0.12], values))).expect("a page");
    let data = data(&html);
    assert_eq!(data[0]["panels"][0]["series"][0]["v"].to_string(), "[0.333333,null,1234.57,2,-3.33333e-10]");
    assert_eq!(data[0]["t"]["n"], 5, "uniform stamps are three numbers");
    assert_eq!(data[0]["t"]["step"], 0.03);
}

#[test]
fn values_that_would_overflow_the_page_are_gaps() {
    let html =
        render(&with(plot(vec![0.0, 1.0, 2.0, 3.0], vec![1.0, 1e151, -1e300, 2e149]))).expect("a page");
    let drawn = &data(&html)[0]["panels"][0]["series"][0]["v"];
    let drawn: Vec<Option<f64>> = serde_json::from_value(drawn.clone()).expect("numbers and gaps");
    assert_eq!(drawn, [Some(1.0), None, None, Some(2e149)]);
}

#[test]
fn non_uniform_stamps_are_listed() {
    let html = render(&with(plot(vec![0.0, 1.0, 3.0], vec![1.0; 3]))).expect("a page");
    assert_eq!(data(&html)[0]["t"].to_string(), "[0,1,3]");
}

#[test]
fn long_records_are_whole_up_to_20000_samples_and_then_keep_every_peak() {
    let record = |n: usize| {
        let mut values: Vec<f64> = (0..n).map(|k| (k as f64 * 0.01).sin()).collect();
        values[n - 777] = 9.0; // one single sample each
        values[n / 3] = -7.0;
        render(&with(TimePlot::sampled("long", 0.001, n).panel(Panel::new("p", "bar").line("p", values))))
            .expect("a page")
    };
    let whole = record(20_000);
    assert_eq!(data(&whole)[0]["panels"][0]["series"][0]["v"].as_array().map(Vec::len), Some(20_000));
    assert!(!whole.contains("Drawn from"));

    let n = 123_457;
    let html = record(n);
    let data = data(&html);
    let values = data[0]["panels"][0]["series"][0]["v"].as_array().expect("values");
    let stamps = data[0]["t"].as_array().expect("listed stamps");
    assert!(values.len() <= 20_000 && values.len() == stamps.len());
    assert!(html.contains(&format!("Drawn from {n} samples")), "the page says that it thinned");
    let of = |k: usize| (values[k].as_f64().expect("finite"), stamps[k].as_f64().expect("finite"));
    let peak = (0..values.len()).max_by(|a, b| of(*a).0.total_cmp(&of(*b).0)).expect("a peak");
    let dip = (0..values.len()).min_by(|a, b| of(*a).0.total_cmp(&of(*b).0)).expect("a dip");
    assert_eq!((of(peak).0, of(dip).0), (9.0, -7.0));
    let bin_s = 0.001 * 13.0; // 123457 samples in at most 10000 bins
    assert!((of(peak).1 - 0.001 * (n - 777) as f64).abs() <= bin_s);
    assert!((of(dip).1 - 0.001 * (n / 3) as f64).abs() <= bin_s);
    assert!((1..stamps.len()).all(|k| of(k).1 > of(k - 1).1), "stamps increase");
}

#[test]
fn the_page_says_how_many_canvases_to_expect() {
    let two = plot(vec![0.0], vec![1.0]).panel(Panel::new("second", "").line("x", [1.0]));
    let xy = XyPlot::new("xy", Axis::new("a", ""), Axis::new("b", "")).points("p", [1.0], [2.0]);
    let report = Report::new("t")
        .section(Section::new("s").block(Details::new("d").block(two)).columns(vec![xy.into()]));
    assert!(render(&report).expect("a page").contains("data-plots-expected=\"3\""));
}

#[test]
fn anchors_are_unique_and_never_those_of_the_page() {
    let html = render(
        &Report::new("t")
            .section(Section::new("Checks").heading("Fit & more"))
            .section(Section::new("Fit, more").id("fit-more"))
            .section(Section::new("λ")),
    )
    .expect("a page");
    for id in ["section-checks", "fit-more", "fit-more--2", "section-"] {
        assert_eq!(html.matches(&format!(" id=\"{id}\"")).count(), 1, "id `{id}`");
        assert!(html.contains(&format!("href=\"#{id}\"")), "the contents lead to `{id}`");
    }
}

#[test]
fn faults_name_the_plot_and_the_numbers() {
    let short = plot(vec![0.0, 1.0], vec![1.0]);
    assert_eq!(message(&with(short)), "plot `record`, `torque`: found 1 values, expected 2");
    let repeated = plot(vec![0.0, 1.0, 1.0], vec![1.0; 3]);
    assert_eq!(
        message(&with(repeated)),
        "plot `record`, axis `Time`: found 1 after 1 at index 2, expected a larger number"
    );
    assert!(message(&with(plot(vec![0.0, f64::NAN], vec![1.0; 2]))).contains("found NaN after 0 at index 1"));
    assert_eq!(
        message(&with(TimePlot::new("none", []))),
        "plot `none`: found no sample, expected at least one"
    );
    let axis = || Axis::new("Speed", "rpm");
    let map = HeatMap::new(
        "map",
        (axis(), vec![1.0, 2.0]),
        (axis(), vec![1.0]),
        (Axis::new("Fuel", "mg"), vec![1.0; 3]),
    );
    assert_eq!(message(&with(map)), "plot `map`, `Fuel`: found 3 values, expected 2");
    let xy = XyPlot::new("xy", axis(), axis()).line("l", [1.0, 2.0], [1.0]);
    assert_eq!(message(&with(xy)), "plot `xy`, `l`: found 1 values, expected 2");
    let bars = Bars::new("bars", axis(), ["a", "b"]).series("one", [1.0]);
    assert_eq!(message(&with(bars)), "plot `bars`, `one`: found 1 values, expected 2");
    let table = Table::new(vec![Column::text("a"), Column::text("b")]).caption("fit").row(["x".into()]);
    assert_eq!(
        message(&with(Details::new("inside").block(table))),
        "table `fit`, row 0: found 1 cells, expected 2"
    );
}

/// Code between backticks is set as code; nothing that a text holds becomes markup by it.
#[test]
fn backticks_are_code() {
    let report = Report::new("t").warning("the key `a<b` and `c`, an odd ` alone").section(Section::new("s"));
    let html = render(&report).expect("a page");
    assert!(html.contains("the key <code>a&lt;b</code> and <code>c</code>, an odd ` alone"), "{html}");
}

/// Maps that are compared may have the colours of one range, lines and points on top.
#[test]
fn a_map_keeps_its_range_and_what_lies_on_top() {
    let axis = || Axis::new("Speed", "rpm");
    let z = (Axis::new("Fuel", "mg"), vec![1.0, 2.0, 3.0, 4.0]);
    let map = HeatMap::new("map", (axis(), vec![1.0, 2.0]), (axis(), vec![1.0, 2.0]), z)
        .range(0.0, 8.0)
        .overlay_line("full load", [1.0, 2.0], [1.5, 1.7])
        .overlay("points", [1.0], [1.0]);
    let plot = &data(&render(&with(map)).expect("a page"))[0];
    assert_eq!(plot["range"], serde_json::json!([0.0, 8.0]));
    assert_eq!((&plot["overlays"][0]["line"], &plot["overlays"][1]["line"]), (&true.into(), &false.into()));
}

/// A band is two sides with one name, and lies below what is added later.
#[test]
fn a_band_has_two_sides_and_one_name() {
    let panel = Panel::new("y", "").band("95 % band", [0.0, 1.0], [2.0, 3.0]).measured([1.0, 2.0]);
    let plot = &data(&render(&with(TimePlot::new("p", [0.0, 1.0]).panel(panel))).expect("a page"))[0];
    let series = &plot["panels"][0]["series"];
    let of = |k: usize| (series[k]["role"].as_str().unwrap(), series[k]["label"].as_str().unwrap());
    assert_eq!([of(0), of(1), of(2)], [("band", "95 % band"), ("band", ""), ("measured", "measured")]);
    let xy = XyPlot::new("xy", Axis::new("x", ""), Axis::new("y", "")).band(
        "band",
        [1.0, 2.0],
        [0.0, 1.0],
        [5.0, 6.0],
    );
    let plot = &data(&render(&with(xy)).expect("a page"))[0];
    assert_eq!(plot["series"][0]["x"], serde_json::json!([1, 2, 2, 1]));
    assert_eq!(plot["series"][0]["y"], serde_json::json!([0, 1, 6, 5]));
}

#[test]
fn faults_are_told_apart_by_kind() {
    let series = Series::new("y", [1.0]).role(Role::Measured);
    let report = with(TimePlot::new("p", [0.0, 1.0]).panel(Panel::new("y", "").series(series)));
    assert!(matches!(render(&report), Err(RenderError::Length { found: 1, expected: 2, .. })));
}

/// Rounding is compared with exact decimal arithmetic, done by hand.
#[test]
fn significant_digits() {
    let cases = [
        (0.0, 3, "0"),
        (9.9996, 4, "10.00"),
        (-0.000_123_45, 3, "-0.000123"),
        (1_234_567.0, 3, "1234567"),
        (12_345_678.0, 3, "1.23e7"),
        (0.000_09, 2, "9.0e-5"),
        (f64::INFINITY, 3, "+inf"),
    ];
    for (value, digits, expected) in cases {
        assert_eq!(significant(value, digits), expected, "{value} with {digits} digits");
    }
}
