pub const BLOB_VERSION: u32 = 1;
