//! Limits that couple channels or choose among values: regions in the plane of inputs, and discrete levels.
//!
//! Inputs are linear in the free variables x (each in \[0, 1\] of its channel's range), so that a region is a set of
//! linear inequalities of x at every sample t:
//!
//! ```text
//! allowed   c' u(t) <= b                        all must hold       (half-plane; the edges of a polygon to stay in)
//! forbidden c_k' u(t) >= b_k for some edge k    one must hold       (convex polygon to stay out of)
//! ```
//!
//! On the way the search pays for a violation (augmented Lagrangian, with the edge that is nearest); what it ends
//! with is moved into the regions by `repair`: projections in turn on what is violated, and, where they do not
//! arrive, on the way back to a record that is known to keep everything. A record that comes out of a design keeps
//! its regions to rounding.

mod levels;
mod region;
mod repair;

pub use region::Region;
pub(crate) use region::Regions;

/// Levels and bounds agree up to this share of the range.
pub(crate) const SAME: f64 = 1e-9;
/// Violation of a region that rounding may leave.
pub(crate) const ROUNDING: f64 = 1e-12;
