//! What the numbers mean, in words.

use dynocal_calib::fuelling::Fuelling;

use super::result::{Driven, Score, Seen, best_rival};

/// Errors on unseen records beyond this multiple of those of the identification: the model does not carry over.
const CARRIES: f64 = 2.0;
/// Share of samples outside of what was seen that is said.
const OUTSIDE: f64 = 0.02;
/// A film that takes away less than this share of the error is none that the records show.
const FILM: f64 = 0.02;

fn worst<'a>(scores: impl Iterator<Item = &'a Score>, of: fn(&Score) -> f64) -> f64 {
    scores.map(of).fold(0.0, f64::max)
}

fn percent(v: f64) -> String {
    dynocal_report::significant(100.0 * v, 3)
}

/// Whether it may be used, and why.
pub(super) fn verdict(scores: &[Score], driven: &[Driven]) -> (bool, Vec<String>) {
    let of = |role: &'static str| scores.iter().filter(move |s| s.role == role);
    let (learnt, unseen) = (worst(of("identification"), |s| s.rms), worst(of("unseen"), |s| s.rms));
    let bare = worst(of("unseen"), |s| s.rms_without_film);
    let carries = unseen <= CARRIES * learnt;
    let spike = |d: &Driven| d.lean.max(d.rich);
    // What it is made for, on a course that tuned nobody, says more of it than an error that runs free.
    let wins =
        driven.first().zip(best_rival(driven)).is_some_and(|(a, b)| a.mean < b.mean && spike(a) < spike(b));
    let mut out = vec![format!(
        "{}: on unseen records the model shows 1 / lambda within {} % (root mean square; {} % on those that identified it, {} % without a film).",
        if carries {
            "The air and film model carries over"
        } else if wins {
            "The air and film model carries over in part"
        } else {
            "The air and film model must not be used"
        },
        percent(unseen),
        percent(learnt),
        percent(bare),
    )];
    if !carries {
        out.push(format!(
            "Its error is more than {CARRIES} times as large where it was not identified: longer records, or records over the whole range, are needed."
        ));
    }
    let (Some(ours), Some(rival)) = (driven.first(), best_rival(driven)) else {
        return (carries, out);
    };
    let (better_mean, better_spike) = (ours.mean < rival.mean, spike(ours) < spike(rival));
    let head = match (better_mean, better_spike) {
        (true, true) => "Driving with it wins",
        (false, false) => "Driving with it loses, and it must not be used",
        _ => "Driving with it wins in one of two",
    };
    out.push(format!(
        "{head}: mean |lambda - 1| {} % against {} % of the best rival ({}), largest deviation {} % against {} %, on a course that tuned nothing, by the lambda that the sensor shows.",
        percent(ours.mean),
        percent(rival.mean),
        rival.name,
        percent(spike(ours)),
        percent(spike(rival)),
    ));
    ((carries && (better_mean || better_spike)) || wins, out)
}

/// What the user should know.
pub(super) fn warnings(f: &Fuelling, scores: &[Score], seen: &Seen) -> Vec<String> {
    let mut out = Vec::new();
    for s in scores.iter().filter(|s| s.role == "unseen" && s.outside > OUTSIDE) {
        out.push(format!(
            "{}: {} % of its samples lie outside of {:.0} to {:.0} rpm and {:.0} to {:.0} kPa, which is what the identification saw",
            s.record,
            percent(s.outside),
            seen.speed_rpm[0],
            seen.speed_rpm[1],
            seen.map_kpa[0],
            seen.map_kpa[1]
        ));
    }
    let of = |of: fn(&Score) -> f64| worst(scores.iter().filter(|s| s.role == "unseen"), of);
    if f.film.share == 0.0 {
        out.push("no fuel film is delivered: on stretches of the records that did not fit it, a model with one was not surely better (99 %), or its inverse would swing".into());
    } else if of(|s| s.rms) > (1.0 - FILM) * of(|s| s.rms_without_film) {
        out.push("the records show no fuel film: without one the unseen records are shown as well; share and time constant of the film say little".into());
    }
    if f.trim.is_none() {
        out.push("no lambda trim: on these records none leaves less error than the model alone".into());
    }
    if f.coolant.is_none() {
        out.push("what the coolant does to film and charge is not known: its temperature was not given, or moved by less than 10 K".into());
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn score(role: &'static str, rms: f64) -> Score {
        Score {
            record: role.into(),
            role,
            length_s: 90.0,
            rms,
            rms_without_film: 0.04,
            rms_of_mixture: 0.1,
            outside: 0.0,
        }
    }

    fn driven(name: &str, rival: bool, mean: f64, lean: f64) -> Driven {
        Driven { name: name.into(), rival, setting: "-".into(), mean, lean, rich: 0.5 * lean }
    }

    /// An error that runs free and is twice as large elsewhere counts where nobody has driven; who has driven and won may drive.
    #[test]
    fn driving_decides_where_there_is_some() {
        let (good, bad) = (
            [score("identification", 0.01), score("unseen", 0.015)],
            [score("identification", 0.01), score("unseen", 0.03)],
        );
        let ours = |mean, lean| vec![driven("ours", false, mean, lean), driven("rival", true, 0.01, 0.2)];
        assert!(verdict(&good, &[]).0 && !verdict(&bad, &[]).0);
        let (valid, text) = verdict(&bad, &ours(0.005, 0.05));
        assert!(valid && text[0].starts_with("The air and film model carries over in part"), "{text:?}");
        assert!(!verdict(&bad, &ours(0.005, 0.3)).0, "one of two is not enough for it");
        assert!(verdict(&good, &ours(0.005, 0.3)).0);
        let (valid, text) = verdict(&good, &ours(0.02, 0.3));
        assert!(!valid && text.iter().any(|t| t.contains("loses, and it must not be used")), "{text:?}");
    }
}
