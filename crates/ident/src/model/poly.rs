//! Polynomial NARX models.
