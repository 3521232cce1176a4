//! The paper's method whole, batch, over images.
