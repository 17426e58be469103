//! Region, filter, detail; selection; execution.
