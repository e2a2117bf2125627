//! Flashing over a debug probe, with the feature `probe`.

#[cfg(feature = "probe")]
pub(super) use with::write;
#[cfg(not(feature = "probe"))]
pub(super) use without::write;

#[cfg(feature = "probe")]
mod with {
    use std::time::Duration;

    use anyhow::Context;
    use indicatif::{ProgressBar, ProgressStyle};
    use probe_rs::{
        Permissions,
        flashing::{DownloadOptions, FlashProgress, ProgressEvent, ProgressOperation},
        probe::{DebugProbeInfo, WireProtocol, list::Lister},
    };
    use r4_image::{Binary, CHIP};

    /// Reason why no debug probe can be used.
    #[derive(Debug, thiserror::Error)]
    enum NoProbe {
        #[error(
            "there is no debug probe{}: connect an ST-LINK V3, a J-Link or a CMSIS-DAP v2 to USB, and its SWD and reset lines to the \
             board's JTAG connector. On Linux only root may use one until the rules from \
             https://probe.rs/docs/getting-started/probe-setup are installed. Without a probe: `r4 flash --dfu`, over USB",
            .asked.as_ref().map(|asked| format!(" {asked}")).unwrap_or_default()
        )]
        None { asked: Option<String> },
        #[error("there are several debug probes: name one with --probe\n{}", .0.join("\n"))]
        Several(Vec<String>),
        #[error("`{0}` names no debug probe: write --probe VID:PID or VID:PID:SERIAL in hex, as in 0483:374e")]
        Name(String),
    }

    /// Writes the image, reads it back and starts it; returns the probe's name.
    pub(in super::super) fn write(binary: &Binary, asked: Option<&str>) -> anyhow::Result<String> {
        let info = find(asked)?;
        let name = info.to_string();
        let mut probe = info.open().with_context(|| {
            format!("cannot open {name}: does another program use it, and may you? https://probe.rs/docs/getting-started/probe-setup")
        })?;
        probe.select_protocol(WireProtocol::Swd).with_context(|| format!("{name} has no SWD"))?;
        let mut session = probe.attach_under_reset(CHIP, Permissions::default()).with_context(|| {
            format!(
                "{name} finds no {CHIP}: is the board powered, and are SWD and the reset line connected? docs/bring-up.md lists \
                 other causes"
            )
        })?;
        let mut loader = session.target().flash_loader();
        loader.add_data(binary.start.into(), &binary.bytes).context("the probe knows no flash there")?;
        let mut options = DownloadOptions::new();
        options.verify = true;
        options.progress = progress();
        loader.commit(&mut session, options).context(
            "the flash was not written correctly: run it again; if it fails again, see option bytes in docs/bring-up.md",
        )?;
        let mut core = session.core(0).context("written, but the processor is not reached: reset the board")?;
        core.reset().context("written, but not started: reset the board")?;
        Ok(name)
    }

    fn find(asked: Option<&str>) -> Result<DebugProbeInfo, NoProbe> {
        let selector = asked.map(|asked| asked.parse().map_err(|_| NoProbe::Name(asked.into())));
        let mut found = Lister::new().list(selector.transpose()?.as_ref());
        match (found.pop(), found.as_slice()) {
            (Some(only), []) => Ok(only),
            (None, _) => Err(NoProbe::None { asked: asked.map(str::to_owned) }),
            (Some(last), others) => {
                Err(NoProbe::Several(others.iter().chain([&last]).map(ToString::to_string).collect()))
            }
        }
    }

    /// Progress of one step at a time: erasing, writing, reading back.
    fn progress() -> FlashProgress<'static> {
        let mut bar = ProgressBar::hidden();
        FlashProgress::new(move |event| match event {
            ProgressEvent::AddProgressBar { total, .. } => bar.inc_length(total.unwrap_or(0)),
            ProgressEvent::Started(operation) => {
                bar.finish_and_clear();
                bar = ProgressBar::new_spinner().with_style(
                    ProgressStyle::with_template("{spinner} {elapsed} {msg}, {bytes}")
                        .unwrap_or(ProgressStyle::default_spinner()),
                );
                bar.enable_steady_tick(Duration::from_millis(200));
                bar.set_message(match operation {
                    ProgressOperation::Erase => "erasing",
                    ProgressOperation::Program => "writing",
                    ProgressOperation::Verify => "reading back",
                    ProgressOperation::Fill => "reading what stays",
                });
            }
            ProgressEvent::Progress { size, .. } => bar.inc(size),
            ProgressEvent::Finished(_) | ProgressEvent::Failed(_) => bar.finish_and_clear(),
            ProgressEvent::DiagnosticMessage { message } => bar.println(message),
            ProgressEvent::FlashLayoutReady { .. } => {}
        })
    }
}

#[cfg(not(feature = "probe"))]
mod without {
    use r4_image::{Binary, CHIP};

    /// Error of programs that are built without the feature `probe`.
    #[derive(Debug, thiserror::Error)]
    #[error(
        "this r4 was built without debug probes. Build one with them, in the repository:\n  \
         cargo install --locked --path host/cli --features probe\n\
         or write the file with probe-rs's own program (https://probe.rs):\n  \
         probe-rs download --chip {CHIP} --protocol swd --connect-under-reset --verify FILE\n\
         Without a probe, over USB: r4 flash --dfu, with the hosted image"
    )]
    struct NotBuilt;

    pub(in super::super) fn write(_: &Binary, _: Option<&str>) -> anyhow::Result<String> {
        Err(NotBuilt.into())
    }
}
