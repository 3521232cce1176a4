//! Sans-io device session
