//! Closed-form laws against printed rows.
