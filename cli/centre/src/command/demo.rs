//! The demonstration.

use std::net::SocketAddr;

use super::{CommandError, print, run::ended};
use crate::demo::{CONFIRMS_AFTER, Demo};

pub(super) fn act(listen: SocketAddr) -> Result<(), CommandError> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()?;
    runtime.block_on(async {
        let demo = Demo::start(listen).await?;
        print(&format!(
            "The page is on http://{}\n  name      {}\n  password  {}\nThree machines are simulated, and nothing is kept. Ctrl-C ends everything.\nTheir models wait until somebody confirms them on the page, under Roll-outs; after {} s the demonstration confirms them by itself.\n",
            demo.address,
            demo.user,
            demo.password,
            CONFIRMS_AFTER.as_secs()
        ))?;
        ended().await?;
        demo.end().await;
        Ok(())
    })
}
