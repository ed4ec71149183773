//! The plant contract of the bed, with save and restore.

use super::bed::{EngineBed, Span};
use super::settings::BedOptions;
use dynocal_ident::plant::{LimitEvent, Plant, PlantError, PlantState, Variable, show};

impl Plant for EngineBed {
    fn variables(&self) -> &[Variable] {
        &self.variables
    }

    fn reset(&mut self, seed: u64) {
        // The start state was taken from this engine, so it always fits.
        let fits = self.engine.restore(&self.start.0);
        debug_assert!(fits.is_ok());
        self.state.clone_from(&self.start.1);
        self.state.seed = seed;
        self.apply_deviations();
        self.events.clear();
        self.take_trips();
    }

    fn step(&mut self, inputs: &[f64], dt_s: f64, outputs: &mut [f64]) -> Result<(), PlantError> {
        if !(dt_s > 0.0 && dt_s <= 10.0) {
            return Err(PlantError::Call(format!("sample time {dt_s} s: expected 0..10 s")));
        }
        self.sample(inputs, Span::Time(dt_s), outputs)
    }

    fn outputs(&self, outputs: &mut [f64]) -> Result<(), PlantError> {
        show(&self.state.shown, outputs)
    }

    fn time_s(&self) -> f64 {
        self.state.time_s
    }

    fn take_events(&mut self) -> Vec<LimitEvent> {
        std::mem::take(&mut self.events)
    }

    fn save(&self) -> PlantState {
        let mut numbers = Vec::new();
        self.state.clone().visit(&mut |x| numbers.push(*x));
        self.engine.state().to_numbers(&mut numbers);
        PlantState(numbers)
    }

    fn restore(&mut self, state: &PlantState) -> Result<(), PlantError> {
        let wrong = || PlantError::Call(format!("{} numbers are no state of this bed", state.0.len()));
        let mut bed = self.state.clone();
        let mut count = 0;
        bed.visit(&mut |_| count += 1);
        let body = state.0.get(count..).ok_or_else(wrong)?;
        let mut engine_state = self.start.0.clone();
        if !engine_state.load_numbers(body) {
            return Err(wrong());
        }
        let mut source = state.0.iter();
        bed.visit(&mut |x| *x = source.next().copied().unwrap_or(*x));
        self.engine.restore(&engine_state).map_err(|e| PlantError::Call(e.to_string()))?;
        self.state = bed;
        self.apply_deviations();
        Ok(())
    }

    fn describe(&self) -> String {
        let n = &self.settings.noise;
        let level = if self.engine.params().turbocharger.is_some() { "F1" } else { "F0" };
        let bed = if self.settings.options == BedOptions::default() { "" } else { ", bed with options" };
        let noise = match self.settings.options.noise_words(n.torque_nm, n.lambda) {
            none if none.is_empty() => "no sensor noise".to_string(),
            some => format!("sensor noise {some}"),
        };
        format!(
            "virtual engine {level}, parameter set {}{bed}, {noise}, dynocal-plant {}",
            self.settings.set_name,
            env!("CARGO_PKG_VERSION")
        )
    }
}
