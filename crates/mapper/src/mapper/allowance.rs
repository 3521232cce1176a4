//! Less work for a while, where there is no time for it.

use super::Mapper;

impl Mapper {
    /// From the next slice on each ping allows so many pairs of work, in place of
    /// `work_pairs_per_ping`; what is put off is done later, or at the end.
    pub fn allow(&mut self, pairs_per_ping: u64) {
        self.config.work_pairs_per_ping = pairs_per_ping;
    }
}
