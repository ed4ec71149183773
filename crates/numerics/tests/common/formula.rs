//! Formulas as text, evaluated with exact first and second derivatives: `x1`, numbers, `pi`, `+ - * / ^`, `sin cos exp ln sqrt`.

use super::Jet;

/// A formula as a tree.
#[derive(Clone, Debug)]
pub enum Formula {
    Number(f64),
    Variable(usize),
    Negative(Box<Formula>),
    Sum(Box<Formula>, Box<Formula>),
    Product(Box<Formula>, Box<Formula>),
    Quotient(Box<Formula>, Box<Formula>),
    /// To a constant power.
    Power(Box<Formula>, f64),
    Function(String, Box<Formula>),
}

struct Reader<'a> {
    text: &'a str,
    at: usize,
}

impl Formula {
    /// Reads a formula; a fault of the table is a panic that says where.
    pub fn parse(text: &str) -> Self {
        let mut reader = Reader { text, at: 0 };
        let formula = reader.sum();
        assert!(reader.peek().is_none(), "{text}: rest from {}", reader.at);
        formula
    }

    /// Value and derivatives.
    pub fn at(&self, x: &[Jet]) -> Jet {
        let n = x.len();
        match self {
            Self::Number(v) => Jet { v: *v, g: vec![0.0; n], h: vec![0.0; n * n] },
            Self::Variable(k) => x[*k].clone(),
            Self::Negative(a) => -a.at(x),
            Self::Sum(a, b) => a.at(x) + b.at(x),
            Self::Product(a, b) => a.at(x) * b.at(x),
            Self::Quotient(a, b) => a.at(x) * power(&b.at(x), -1.0),
            Self::Power(a, p) => power(&a.at(x), *p),
            Self::Function(name, a) => {
                let a = a.at(x);
                let v = a.v;
                match name.as_str() {
                    "sin" => a.chain(v.sin(), v.cos(), -v.sin()),
                    "cos" => a.chain(v.cos(), -v.sin(), -v.cos()),
                    "exp" => a.chain(v.exp(), v.exp(), v.exp()),
                    "ln" => a.chain(v.ln(), 1.0 / v, -1.0 / (v * v)),
                    "sqrt" => power(&a, 0.5),
                    other => panic!("no function {other}"),
                }
            }
        }
    }
}

/// `a^p`; whole powers of zero have their derivatives, too.
fn power(a: &Jet, p: f64) -> Jet {
    let term = |factor: f64, q: f64| if factor == 0.0 { 0.0 } else { factor * raise(a.v, q) };
    a.chain(raise(a.v, p), term(p, p - 1.0), term(p * (p - 1.0), p - 2.0))
}

fn raise(v: f64, p: f64) -> f64 {
    if p.fract() == 0.0 { v.powi(p as i32) } else { v.powf(p) }
}

impl Reader<'_> {
    fn peek(&mut self) -> Option<char> {
        let rest = &self.text[self.at..];
        self.at += rest.len() - rest.trim_start().len();
        self.text[self.at..].chars().next()
    }

    fn take(&mut self, c: char) -> bool {
        let found = self.peek() == Some(c);
        self.at += usize::from(found);
        found
    }

    fn word(&mut self, of: impl Fn(char) -> bool) -> String {
        self.peek();
        let word: String = self.text[self.at..].chars().take_while(|c| of(*c)).collect();
        self.at += word.len();
        word
    }

    fn sum(&mut self) -> Formula {
        let mut left = self.product();
        loop {
            let minus = match self.peek() {
                Some('+') => false,
                Some('-') => true,
                _ => return left,
            };
            self.at += 1;
            let right = self.product();
            let right = if minus { Formula::Negative(Box::new(right)) } else { right };
            left = Formula::Sum(Box::new(left), Box::new(right));
        }
    }

    fn product(&mut self) -> Formula {
        let mut left = self.signed();
        loop {
            if self.take('*') {
                left = Formula::Product(Box::new(left), Box::new(self.signed()));
            } else if self.take('/') {
                left = Formula::Quotient(Box::new(left), Box::new(self.signed()));
            } else {
                return left;
            }
        }
    }

    fn signed(&mut self) -> Formula {
        if self.take('-') { Formula::Negative(Box::new(self.signed())) } else { self.power() }
    }

    fn power(&mut self) -> Formula {
        let base = self.atom();
        if !self.take('^') {
            return base;
        }
        let sign = if self.take('-') { -1.0 } else { 1.0 };
        let Formula::Number(p) = self.atom() else { panic!("{}: a power is a number", self.text) };
        Formula::Power(Box::new(base), sign * p)
    }

    fn atom(&mut self) -> Formula {
        match self.peek() {
            Some('(') => self.bracket(),
            Some(c) if c.is_ascii_digit() => {
                let mut number = self.word(|c| c.is_ascii_digit() || c == '.' || c == 'e');
                if number.ends_with('e') {
                    number.push_str(&self.word(|c| c.is_ascii_digit() || c == '-'));
                }
                Formula::Number(number.parse().expect("number"))
            }
            _ => {
                let word = self.word(|c| c.is_ascii_alphanumeric());
                match word.strip_prefix('x').and_then(|k| k.parse::<usize>().ok()) {
                    Some(k) => Formula::Variable(k - 1),
                    None if word == "pi" => Formula::Number(std::f64::consts::PI),
                    None => Formula::Function(word, Box::new(self.bracket())),
                }
            }
        }
    }

    fn bracket(&mut self) -> Formula {
        assert!(self.take('('), "{}: ( expected at {}", self.text, self.at);
        let inner = self.sum();
        assert!(self.take(')'), "{}: ) expected at {}", self.text, self.at);
        inner
    }
}
