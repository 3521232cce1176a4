//! The Blue Robotics Ping wire format as the OmniScan 450 speaks it
