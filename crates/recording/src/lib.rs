//! Files: logs, trajectories, maps
