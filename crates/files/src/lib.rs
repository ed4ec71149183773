//! Reading and writing measurement and result files
