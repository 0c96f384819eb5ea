"""`wtg-gym warmup`: compile before the first use."""

from wtg_gym.cli.output import say


def warmup() -> int:
    """Compile the simulator to machine code now rather than at the first use.

    It takes half a minute for both versions, of which a first step or score needs a part. The machine code is kept and
    serves every plant.

    examples:
      wtg-gym warmup
      XDG_CACHE_HOME=/opt/cache wtg-gym warmup     keep the machine code in /opt/cache/wtg_gym, as for an image
    """
    from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
    from wtg_gym.envs.settings import VERSIONS, EnvSettings
    from wtg_gym.evaluation import evaluate
    from wtg_gym.physics.tracking_law import REFERENCE_LAW
    from wtg_gym.physics.trajectory import simulate
    from wtg_gym.systems.compiled import cache_folder, compilation

    for version in VERSIONS:
        environment: GFMWTGEnv | GFMWTGVectorEnv
        for environment in (GFMWTGEnv(version=version), GFMWTGVectorEnv(2, version=version)):
            environment.reset(seed=0)
            environment.step(environment.action_space.sample())
            environment.close()
        settings = EnvSettings(version=version)
        seed = settings.resolved_suite.validation[0]
        simulate(settings.resolved_suite.scenario(seed), REFERENCE_LAW, settings.resolved_plant)
        evaluate([], settings.suite_name, seeds=(seed,), duration_s=1.0)
    done, folder = compilation(), cache_folder()
    where = "not kept, since no folder can be written to" if folder is None else f"kept in {folder}"
    if done.n_functions == 0:
        say(f"nothing to compile: machine code came with the package or is in {folder}")
    else:
        say(f"functions compiled: {done.n_functions}, in {done.seconds:.0f} s; {where}")
    return 0
