//! Placeholder docs, filled by the module's change.
