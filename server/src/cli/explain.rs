//! `welkin explain`.

use clap::Args;
use welkin_proto::wire::PlanReport;

use super::{Failure, Outcome, SceneFlags, columns, own_limits, print_line};
use crate::picture::{self, Renderer};
use crate::world::World;

pub(super) const EXAMPLES: &str = "\
Examples:
  welkin explain fair-weather-cumulus
  welkin explain clear-sky-wind --json";

#[derive(Args)]
pub(super) struct Options {
    /// A preset's name or the path of a JSON document.
    scene: String,
    /// Print the plan as JSON.
    #[arg(long)]
    json: bool,
    /// Ticks to run, so that there are times to show; 0 shows the plan alone.
    #[arg(long, value_name = "N", default_value_t = 3)]
    ticks: u32,
    #[command(flatten)]
    flags: SceneFlags,
}

pub(super) fn run(options: Options) -> Result<Outcome, Failure> {
    let scene = options.flags.load(&options.scene, &own_limits())?;
    let machine = options.flags.machine()?;
    let mut renderer = Renderer::new(&machine.compute);
    let mut world = World::new(scene, machine)?;
    for _ in 0..options.ticks {
        world.tick();
    }
    let mut plan = world.plan_report();
    if options.ticks > 0 {
        let scene = world.scene();
        renderer.render(&world.snapshot(), scene, &scene.camera, [640, 360], false)?;
        picture::put_times(&mut plan, renderer.times());
    }
    let text = if options.json {
        serde_json::to_string_pretty(&plan).map_err(|error| Failure(error.to_string()))?
    } else {
        table(&world, &plan)
    };
    print_line(text.trim_end())?;
    Ok(Outcome::Done)
}

fn table(world: &World, plan: &PlanReport) -> String {
    let scene = world.scene();
    let [x, y, z] = scene.domain.cells;
    let mut text = format!("{}: {x} x {y} x {z} cells on {}\n\n", scene.name, plan.device);
    let head = ["LADDER", "RUNG", "BECAUSE OF", "WHAT IT DOES", "KEEPS"].map(str::to_owned);
    let ladders = plan.ladders.iter().map(|ladder| {
        [
            ladder.ladder.clone(),
            ladder.rung.clone(),
            ladder.why.clone(),
            ladder.what.clone(),
            ladder.keeps.clone(),
        ]
    });
    text += &columns(std::iter::once(head).chain(ladders).collect(), [false; 5]);
    if let Some(courant_max) = plan.courant_max {
        text += &format!("A substep's Courant number is {courant_max} at most.\n");
    }
    text += "\n";
    let head = ["PASS", "PHASE", "RUNS", "MEAN MS", "BYTES A CELL", "WHY"].map(str::to_owned);
    let passes = plan.passes.iter().map(|pass| {
        let mean_ms = pass.mean_ms.map_or_else(|| "-".to_owned(), |ms| format!("{ms:.3}"));
        [
            pass.stage.clone(),
            pass.phase.clone(),
            pass.runs.to_string(),
            mean_ms,
            pass.bytes_per_cell.map_or_else(|| "-".to_owned(), |b| b.to_string()),
            pass.why.clone(),
        ]
    });
    text += &columns(
        std::iter::once(head).chain(passes).collect(),
        [false, false, true, true, true, false],
    );
    let head = ["FIELD", "PLACE", "UNIT", "BYTES"].map(str::to_owned);
    let fields = plan.fields.iter().map(|field| {
        [
            field.name.clone(),
            field.place.clone(),
            field.unit.clone(),
            field.bytes.to_string(),
        ]
    });
    text += "\n";
    text += &columns(
        std::iter::once(head).chain(fields).collect(),
        [false, false, false, true],
    );
    text += &format!(
        "\n{} passes, {} fields, {:.1} MiB\n",
        plan.passes.len(),
        plan.fields.len(),
        plan.bytes as f64 / f64::from(1 << 20)
    );
    text
}
