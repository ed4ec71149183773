//! Channels that follow from others: tables `derive`.

use dynocal_files::dataset::ChannelSpec;
use dynocal_files::spec::Faults;
use dynocal_ident::data::Role;
use dynocal_ident::derived::{Derived, DerivedError};
use serde::Serialize;

use super::typed::TypedDerive;

/// A derived channel and what it is for.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DeriveSpec {
    /// What it is.
    pub channel: Derived,
    /// What it is for.
    pub role: Role,
}

/// Derived channels in the order of the file; each may follow from those before.
pub(super) fn derive(
    typed: &[TypedDerive],
    channels: &[ChannelSpec],
    faults: &mut Faults,
) -> Vec<DeriveSpec> {
    let mut known: Vec<String> = channels.iter().map(|c| c.name.clone()).collect();
    let mut out = Vec::new();
    for (k, d) in typed.iter().enumerate() {
        let key = |part: &str| format!("derive[{}].{part}", k + 1);
        let name = faults.required(&key("name"), &d.name, "the name of the new channel");
        let powers =
            faults.required(&key("powers"), &d.powers, "channels with whole powers, e.g. { speed = -1 }");
        let (Some(name), Some(powers)) = (name, powers) else { continue };
        let unit = d.unit.clone().unwrap_or_else(|| "-".into());
        let channel = Derived { name: name.clone(), unit, factor: d.factor.unwrap_or(1.0), powers };
        match channel.check(&known) {
            Ok(()) => {}
            Err(DerivedError::Definition { message, .. }) => {
                faults.push(
                    &format!("derive[{}]", k + 1),
                    message,
                    "a monomial of channels that come before it",
                );
            }
            Err(other) => faults.push(&format!("derive[{}]", k + 1), other, "a monomial of channels"),
        }
        known.push(name);
        out.push(DeriveSpec { channel, role: d.role.unwrap_or(Role::Auxiliary) });
    }
    out
}

/// Derived channels as the model's table sees them: like measured ones.
pub(super) fn as_channels(derived: &[DeriveSpec]) -> impl Iterator<Item = ChannelSpec> {
    derived.iter().map(|d| ChannelSpec {
        column: d.channel.name.clone(),
        name: d.channel.name.clone(),
        unit: Some(d.channel.unit.clone()),
        convert: false,
        role: d.role,
    })
}
