//! The text form of a regressor: `name(t-lag)^power * tanh(2*name(t-1) - 0.5)^power * ...`.

use dynocal_numerics::registry::nearest;

use super::function::{Function, SHAPES, Shape};
use super::regressor::{Factor, MAX_DEGREE, Source, StructureError};

/// A factor as read.
pub(super) enum Parsed {
    Plain(Factor),
    Function(Function),
}

/// Where a text is read: the whole regressor, for messages, and the channel names.
pub(super) struct Context<'a> {
    pub(super) text: &'a str,
    pub(super) inputs: &'a [String],
    pub(super) output: &'a str,
}

impl Context<'_> {
    fn syntax(&self, found: &str, expected: &'static str) -> StructureError {
        StructureError::Syntax { text: self.text.into(), found: found.into(), expected }
    }

    fn find(&self, name: &str) -> Option<Source> {
        match self.inputs.iter().position(|n| n == name) {
            Some(i) => Some(Source::Input(i)),
            None => (name == self.output).then_some(Source::Output),
        }
    }

    fn source(&self, name: &str) -> Result<Source, StructureError> {
        self.find(name).ok_or_else(|| {
            let known: Vec<String> = self.inputs.iter().cloned().chain([self.output.to_string()]).collect();
            StructureError::UnknownChannel {
                text: self.text.into(),
                found: name.into(),
                nearest: nearest(name, &known),
                known,
            }
        })
    }

    /// All factors.
    pub(super) fn factors(&self) -> Result<Vec<Parsed>, StructureError> {
        split_product(self.text).map(|part| self.factor(part.trim())).collect()
    }

    /// `name(t-lag)^power` or `shape(argument)^power`.
    fn factor(&self, part: &str) -> Result<Parsed, StructureError> {
        let open = part.find('(');
        let open = open.ok_or_else(|| self.syntax(part, "`name(t-lag)` or `name(t-lag)^power`"))?;
        let close = part.rfind(')').filter(|c| *c > open);
        let close = close.ok_or_else(|| self.syntax(part, "a closing `)`"))?;
        let (name, inside) = (part[..open].trim(), part[open + 1..close].trim());
        let power = self.power(part[close + 1..].trim())?;
        if !inside.contains('(') {
            let source = self.source(name)?;
            return Ok(Parsed::Plain(Factor { source, lag: self.lag(inside)?, power }));
        }
        let Some(shape) = SHAPES.iter().find(|(n, _)| *n == name).map(|(_, s)| *s) else {
            return Err(self.syntax(name, "one of abs, cos, exp, pos, sin, sqrt, tanh before an argument"));
        };
        self.function(shape, inside, power).map(Parsed::Function)
    }

    fn power(&self, rest: &str) -> Result<u32, StructureError> {
        match rest.strip_prefix('^') {
            Some(digits) => {
                let power = digits.trim().parse().ok().filter(|p| (1..=MAX_DEGREE).contains(p));
                power.ok_or_else(|| self.syntax(digits, "a power from 1 to 12"))
            }
            None if rest.is_empty() => Ok(1),
            None => Err(self.syntax(rest, "`^power` or `*`")),
        }
    }

    /// `t` or `t-lag`.
    fn lag(&self, delay: &str) -> Result<usize, StructureError> {
        let rest = delay.strip_prefix('t').ok_or_else(|| self.syntax(delay, "`t` or `t-lag`"))?.trim();
        match rest.strip_prefix('-') {
            Some(digits) => digits.trim().parse().map_err(|_| self.syntax(digits, "a lag in samples")),
            None if rest.is_empty() => Ok(0),
            None => Err(self.syntax(rest, "`t` or `t-lag`")),
        }
    }

    /// The argument `c1*name(t-lag) + ... - c0` of a function.
    fn function(&self, shape: Shape, argument: &str, power: u32) -> Result<Function, StructureError> {
        let (mut reads, mut offset, mut rest) = (Vec::new(), 0.0, argument.trim());
        let mut first = true;
        while first || !rest.is_empty() {
            let (sign, term) = match (rest.strip_prefix('-'), rest.strip_prefix('+')) {
                (Some(term), _) => (-1.0, term.trim_start()),
                (None, Some(term)) => (1.0, term.trim_start()),
                (None, None) if first => (1.0, rest),
                (None, None) => return Err(self.syntax(rest, "`+` or `-` between summands")),
            };
            first = false;
            let (gain, term) = match self.read_at(term) {
                Some(_) => (1.0, term),
                None => {
                    let (value, after) = self.number(term)?;
                    match after.strip_prefix('*') {
                        Some(term) => (value, term.trim_start()),
                        None => {
                            offset += sign * value;
                            rest = after;
                            continue;
                        }
                    }
                }
            };
            let Some((name, delay, after)) = self.read_at(term) else {
                let name = term.split('(').next().unwrap_or(term).trim();
                self.source(name)?;
                return Err(self.syntax(term, "`name(t-lag)`"));
            };
            reads.push((self.source(name)?, self.lag(delay)?, sign * gain));
            rest = after;
        }
        Function::new(shape, offset, &reads, power)
            .ok_or_else(|| self.syntax(argument, "a finite combination of at least one lagged channel"))
    }

    /// (name, delay, what follows) where `term` begins with a known channel.
    fn read_at<'t>(&self, term: &'t str) -> Option<(&'t str, &'t str, &'t str)> {
        let open = term.find('(')?;
        let close = open + term[open..].find(')')?;
        let name = term[..open].trim();
        self.find(name)?;
        Some((name, term[open + 1..close].trim(), term[close + 1..].trim_start()))
    }

    /// The longest number that `term` begins with, and what follows.
    fn number<'t>(&self, term: &'t str) -> Result<(f64, &'t str), StructureError> {
        let ends = term.char_indices().map(|(i, c)| i + c.len_utf8()).take(32).collect::<Vec<_>>();
        let number = ends.into_iter().rev().find_map(|end| {
            let digits = term[..end].trim_end();
            let numeric = digits.starts_with(|c: char| c.is_ascii_digit() || c == '.');
            digits.parse::<f64>().ok().filter(|v| numeric && v.is_finite()).map(|v| (v, &term[end..]))
        });
        match number {
            Some((value, rest)) => Ok((value, rest.trim_start())),
            None => {
                let name = term.split('(').next().unwrap_or(term).trim();
                if term.contains('(') && !name.is_empty() {
                    self.source(name)?;
                }
                Err(self.syntax(term, "`name(t-lag)`, `number*name(t-lag)` or a number"))
            }
        }
    }
}

/// The parts between the `*` that stand outside of parentheses.
fn split_product(text: &str) -> impl Iterator<Item = &str> {
    let mut depth = 0_usize;
    text.split(move |c| {
        match c {
            '(' => depth += 1,
            ')' => depth = depth.saturating_sub(1),
            _ => {}
        }
        c == '*' && depth == 0
    })
}
