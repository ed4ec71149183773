//! Where the channels of fuelling lie on a plant, and how their units become ours.

use dynocal_calib::fuelling::Sensed;
use dynocal_files::units;
use dynocal_ident::plant::{Causality, Plant, Variable};

use super::spec::Channels;

/// Where a channel lies, and how its unit becomes ours: `value * scale + offset`.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Place among inputs or outputs.
    pub at: usize,
    scale: f64,
    offset: f64,
}

impl Place {
    /// A channel by name, in a unit or as it is.
    ///
    /// # Errors
    /// In words: no such channel, or a unit that does not convert.
    pub fn of(all: &[Variable], name: &str, unit: Option<&str>, what: &str) -> Result<Self, String> {
        let Some(at) = all.iter().position(|v| v.name == name) else {
            let names: Vec<&str> = all.iter().map(|v| v.name.as_str()).collect();
            return Err(format!("the plant has no {what} `{name}`; it has {}", names.join(", ")));
        };
        let own = all[at].unit.as_str();
        let Some(unit) = unit else { return Ok(Self { at, scale: 1.0, offset: 0.0 }) };
        let (scale, offset) = units::conversion(own, unit).ok_or_else(|| {
            format!("`{name}` of the plant is in {own}, expected a unit that converts to {unit}")
        })?;
        Ok(Self { at, scale, offset })
    }

    /// The value in our unit.
    pub fn get(self, values: &[f64]) -> f64 {
        values[self.at] * self.scale + self.offset
    }

    /// Sets a value that is in our unit.
    pub fn set(self, values: &mut [f64], value: f64) {
        values[self.at] = (value - self.offset) / self.scale;
    }
}

/// A place among inputs or among outputs: what is commanded, or what is measured of it.
#[derive(Clone, Copy, Debug)]
pub enum Side {
    /// Commanded.
    Input(Place),
    /// Measured.
    Output(Place),
}

impl Side {
    /// An output of that name, or else an input.
    ///
    /// # Errors
    /// As of [`Place::of`].
    fn of(inputs: &[Variable], outputs: &[Variable], name: &str, unit: &str) -> Result<Self, String> {
        if outputs.iter().any(|v| v.name == name) {
            return Place::of(outputs, name, Some(unit), "output").map(Self::Output);
        }
        Place::of(inputs, name, Some(unit), "output or input").map(Self::Input)
    }

    /// The value in our unit.
    pub fn get(self, inputs: &[f64], outputs: &[f64]) -> f64 {
        match self {
            Self::Input(p) => p.get(inputs),
            Self::Output(p) => p.get(outputs),
        }
    }
}

/// The channels that fuelling reads and sets.
#[derive(Clone, Debug)]
pub struct Places {
    /// Speed in rpm, an input.
    pub speed: Place,
    /// Throttle in deg, an input.
    pub throttle: Place,
    /// Injection in the unit of the plant, an input.
    pub injection: Place,
    /// Unit of the injection.
    pub injection_unit: String,
    /// Manifold pressure in kPa, an output.
    pub map: Place,
    /// Lambda as the sensor shows it, an output.
    pub lambda: Place,
    /// Pressure before the throttle in kPa, an output where there is one.
    pub boost: Option<Place>,
    /// Coolant temperature in degC, an output where there is one.
    pub coolant: Option<Place>,
    /// Places of intake and exhaust cam in deg, where they count.
    pub cams: Option<[Side; 2]>,
}

/// Variables of one direction, in the order of the plant.
pub fn variables(plant: &dyn Plant, causality: Causality) -> Vec<Variable> {
    plant.variables().iter().filter(|v| v.causality == causality).cloned().collect()
}

impl Places {
    /// Finds the channels on a plant.
    ///
    /// # Errors
    /// In words: [`Place::of`].
    pub fn of(plant: &dyn Plant, names: &Channels) -> Result<Self, String> {
        let (inputs, outputs) = (variables(plant, Causality::Input), variables(plant, Causality::Output));
        let output = |name: &str, unit: &str| Place::of(&outputs, name, Some(unit), "output");
        let injection = Place::of(&inputs, &names.injection, None, "input")?;
        Ok(Self {
            speed: Place::of(&inputs, &names.speed, Some("rpm"), "input")?,
            throttle: Place::of(&inputs, &names.throttle, Some("deg"), "input")?,
            injection,
            injection_unit: inputs[injection.at].unit.clone(),
            map: output(&names.map, "kPa")?,
            lambda: output(&names.lambda, "-")?,
            boost: names.boost.as_deref().map(|b| output(b, "kPa")).transpose()?,
            coolant: names.coolant.as_deref().map(|c| output(c, "degC")).transpose()?,
            cams: match names.cams() {
                Some([i, e]) => {
                    Some([Side::of(&inputs, &outputs, i, "deg")?, Side::of(&inputs, &outputs, e, "deg")?])
                }
                None => None,
            },
        })
    }

    /// What a controller knows: speed in rpm and throttle in deg as they are commanded, and inputs and outputs of the sample before.
    pub fn sensed(&self, (speed_rpm, throttle_deg): (f64, f64), inputs: &[f64], outputs: &[f64]) -> Sensed {
        Sensed {
            speed_rpm,
            throttle_deg,
            map_kpa: self.map.get(outputs),
            upstream_kpa: self.boost.map(|b| b.get(outputs)),
            coolant_c: self.coolant.map_or(f64::NAN, |c| c.get(outputs)),
            cams_deg: self.cams.map(|cams| cams.map(|c| c.get(inputs, outputs))),
            lambda: Some(self.lambda.get(outputs)),
        }
    }
}
