//! What one ping sees of Gaussians
