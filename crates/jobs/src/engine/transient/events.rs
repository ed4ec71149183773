//! Limits that were touched, as stretches of time instead of samples.

use dynocal_ident::plant::LimitEvent;
use dynocal_plant::testbed::guard::Trip;

/// Events of one limit that follow each other by less than [`APART_S`].
#[derive(Clone, Debug, PartialEq)]
pub struct EventGroup {
    /// What was touched.
    pub what: String,
    /// The limit.
    pub limit: f64,
    /// First event in s.
    pub from_s: f64,
    /// Last event in s, or the end of the trip that it begins.
    pub to_s: f64,
    /// Events.
    pub count: usize,
    /// Value farthest from the limit at an event: what it rises to between events is in the record.
    pub worst: f64,
}

/// Time in s between events from which on they are two stretches.
pub const APART_S: f64 = 1.0;

/// Groups events, in the order in which the groups begin. A trip is one event and lasts: its stretch ends with it.
///
/// ```
/// use dynocal_ident::plant::LimitEvent;
/// use dynocal_jobs::engine::transient::grouped;
/// use dynocal_plant::testbed::guard::Trip;
/// let event = |time_s, value| LimitEvent { time_s, what: "knock".into(), value, limit: 1.0 };
/// let groups = grouped(&[event(0.1, 1.1), event(0.2, 1.3), event(0.3, 1.2), event(7.0, 1.1)], &[]);
/// assert_eq!(groups.len(), 2);
/// assert_eq!((groups[0].from_s, groups[0].to_s, groups[0].count, groups[0].worst), (0.1, 0.3, 3, 1.3));
/// let cut = LimitEvent { time_s: 2.0, what: "map trip".into(), value: 101.0, limit: 100.0 };
/// let groups = grouped(&[cut], &[Trip { what: "map trip".into(), from_s: 2.0, to_s: 5.5 }]);
/// assert_eq!((groups[0].from_s, groups[0].to_s, groups[0].count), (2.0, 5.5, 1));
/// ```
pub fn grouped(events: &[LimitEvent], trips: &[Trip]) -> Vec<EventGroup> {
    let mut groups: Vec<EventGroup> = Vec::new();
    let end_s = |e: &LimitEvent| {
        let own = trips.iter().find(|t| t.what == e.what && t.from_s == e.time_s);
        own.map_or(e.time_s, |t| t.to_s)
    };
    for e in events {
        let open = groups.iter_mut().rev().find(|g| g.what == e.what && g.limit == e.limit);
        match open.filter(|g| e.time_s - g.to_s < APART_S) {
            Some(g) => {
                g.to_s = end_s(e);
                g.count += 1;
                if (e.value - e.limit).abs() > (g.worst - g.limit).abs() {
                    g.worst = e.value;
                }
            }
            None => groups.push(EventGroup {
                what: e.what.clone(),
                limit: e.limit,
                from_s: e.time_s,
                to_s: end_s(e),
                count: 1,
                worst: e.value,
            }),
        }
    }
    groups
}
