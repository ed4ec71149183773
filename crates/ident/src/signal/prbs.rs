//! Pseudo-random binary sequence of maximum length.
//!
//! A shift register of order n with feedback `a(k) = a(k - i) xor a(k - j) ..` from a primitive polynomial repeats
//! after P = 2^n - 1 bits. Over a period its autocorrelation, as +-1, has two values only: P at lag 0 and -1 at
//! all others. (S. W. Golomb, Shift Register Sequences, 1967.)

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use super::Signal;
use super::common::{check_range, fault, samples};

pub(super) const MEMBER: Member<dyn Signal> = Member {
    doc: MemberDoc {
        name: "prbs",
        what: "two levels from a maximum-length shift register",
        params: &[
            ParamDoc { name: "lo", unit: "channel", default: "", what: "lower level" },
            ParamDoc { name: "hi", unit: "channel", default: "", what: "upper level" },
            ParamDoc {
                name: "order",
                unit: "-",
                default: "9",
                what: "order of the register, 2 to 31; period 2^order - 1 holds",
            },
            ParamDoc { name: "hold_s", unit: "s", default: "", what: "time of one bit" },
        ],
    },
    build: |keys| {
        let signal: Prbs = registry::keys("prbs", keys)?;
        check_range("prbs", signal.lo, signal.hi)?;
        if !(2..=31).contains(&signal.order) {
            return Err(fault("prbs", format!("found order = {}, expected 2 to 31", signal.order)));
        }
        Ok(Box::new(signal))
    },
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Prbs {
    lo: f64,
    hi: f64,
    #[serde(default = "nine")]
    order: usize,
    hold_s: f64,
}

fn nine() -> usize {
    9
}

/// Feedback delays of primitive polynomials for the orders 2 to 31 (unused places are 0).
#[rustfmt::skip]
const TAPS: [[u32; 4]; 30] = [
    [2, 1, 0, 0], [3, 2, 0, 0], [4, 3, 0, 0], [5, 3, 0, 0], [6, 5, 0, 0], [7, 6, 0, 0], [8, 6, 5, 4], [9, 5, 0, 0],
    [10, 7, 0, 0], [11, 9, 0, 0], [12, 6, 4, 1], [13, 4, 3, 1], [14, 5, 3, 1], [15, 14, 0, 0], [16, 15, 13, 4],
    [17, 14, 0, 0], [18, 11, 0, 0], [19, 6, 2, 1], [20, 17, 0, 0], [21, 19, 0, 0], [22, 21, 0, 0], [23, 18, 0, 0],
    [24, 23, 22, 17], [25, 22, 0, 0], [26, 6, 2, 1], [27, 5, 2, 1], [28, 25, 0, 0], [29, 27, 0, 0], [30, 6, 4, 1],
    [31, 28, 0, 0],
];

/// Bits of the state that are fed back: bit i holds a(k - 1 - i).
fn feedback(order: usize) -> u32 {
    TAPS[order - 2].iter().filter(|tap| **tap > 0).fold(0, |mask, tap| mask | 1 << (tap - 1))
}

impl Signal for Prbs {
    fn fill(&self, u: &mut [f64], dt_s: f64, rng: &mut Rng64) -> Result<(), BuildError> {
        let hold = samples("prbs", "hold_s", self.hold_s, dt_s)?;
        let (mask, all) = (feedback(self.order), (1u32 << self.order) - 1);
        // Any state but zero starts the same cycle somewhere.
        let mut state = 1 + rng.below(all as usize) as u32;
        for bit in u.chunks_mut(hold) {
            let next = (state & mask).count_ones() & 1;
            state = (state << 1 | next) & all;
            bit.fill(if next == 1 { self.hi } else { self.lo });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// a b modulo the polynomial of degree n over GF(2).
    fn times(a: u64, b: u64, polynomial: u64, n: usize) -> u64 {
        let mut product = 0;
        for i in (0..n).rev() {
            product <<= 1;
            if product >> n & 1 == 1 {
                product ^= polynomial;
            }
            if b >> i & 1 == 1 {
                product ^= a;
            }
        }
        product
    }

    fn prime_factors(mut v: u64) -> Vec<u64> {
        let mut factors = Vec::new();
        let mut q = 2;
        while q * q <= v {
            if v.is_multiple_of(q) {
                factors.push(q);
                while v.is_multiple_of(q) {
                    v /= q;
                }
            }
            q += 1;
        }
        if v > 1 {
            factors.push(v);
        }
        factors
    }

    /// Every polynomial is primitive: x has order 2^n - 1 exactly.
    #[test]
    fn all_orders_have_maximum_length() {
        for n in 2..=31usize {
            // a(k) = sum a(k - tap) has the polynomial x^n + sum x^(n - tap).
            let taps = TAPS[n - 2].iter().filter(|t| **t > 0);
            let polynomial = taps.fold(1u64 << n, |p, t| p ^ 1 << (n - *t as usize));
            let period = (1u64 << n) - 1;
            let x_to = |mut e: u64| {
                let (mut base, mut result) = (2u64, 1u64);
                while e > 0 {
                    if e & 1 == 1 {
                        result = times(result, base, polynomial, n);
                    }
                    base = times(base, base, polynomial, n);
                    e >>= 1;
                }
                result
            };
            assert_eq!(x_to(period), 1, "order {n}");
            for q in prime_factors(period).into_iter().filter(|q| *q < period) {
                assert_ne!(x_to(period / q), 1, "order {n}: period divides {}", period / q);
            }
        }
    }

    #[test]
    fn autocorrelation_over_a_period_is_two_valued() {
        for order in 2..=11 {
            let period = (1usize << order) - 1;
            let mut u = vec![0.0; period];
            let signal = Prbs { lo: -1.0, hi: 1.0, order, hold_s: 0.1 };
            signal.fill(&mut u, 0.1, &mut Rng64::new(order as u64)).unwrap();
            for lag in 0..period {
                let sum: f64 = (0..period).map(|t| u[t] * u[(t + lag) % period]).sum();
                assert_eq!(sum, if lag == 0 { period as f64 } else { -1.0 }, "order {order}, lag {lag}");
            }
        }
    }
}
