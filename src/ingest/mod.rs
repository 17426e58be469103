//! Files to store, parallel, out of core.
