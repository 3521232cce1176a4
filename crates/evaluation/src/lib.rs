//! Metrics and reports
