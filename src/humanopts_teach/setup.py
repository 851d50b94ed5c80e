from glob import glob
from pathlib import Path
import sys
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = 'humanopts_teach'
MANIFEST = ElementTree.parse('package.xml')
# Executables of ros2 run, which is not there where wheels are installed.
NODES = [
    'diagnostics = humanopts_teach.ros.diagnostics:main',
    'joy_teleop = humanopts_teach.ros.joy_teleop:main',
    'keyboard_teleop = humanopts_teach.ros.keyboard_teleop:main',
    'lesson = humanopts_teach.ros.lesson_node:main',
    'recorder = humanopts_teach.ros.recorder:main',
    'simulated_teacher = humanopts_teach.ros.simulated_teacher:main',
    'views = humanopts_teach.ros.views:main',
]
SCRIPTS = ['humanopts = humanopts_teach.cli:main'] + ([] if 'bdist_wheel' in sys.argv else NODES)

setup(
    name=NAME,
    version=MANIFEST.findtext('version'),
    description=MANIFEST.findtext('description'),
    long_description=Path('README.md').read_text('utf-8'),
    long_description_content_type='text/markdown',
    license=MANIFEST.findtext('license'),
    install_requires=[
        'humanopts-env',
        'humanopts-learner',
        'humanopts-ros',
        'jinja2>=3.1.2',
        'lazy-loader>=0.3',
        'markdown-it-py>=3.0.0',
        'matplotlib>=3.6.3',
        'mcap-ros2-support>=0.5.5',
        'mcap>=1.2',
        'numpy>=1.26.4',
        'pandas>=2.1.4',
        'pillow>=10.2.0',
        'polib>=1.1.1',
        'prompt-toolkit>=3.0.43',
        'psutil>=5.9.8',
        'pydantic>=2.7',
        'pyyaml>=6.0.1',
        'rich>=13.7.1',
        'scikit-learn>=1.4.1',
        'scipy>=1.11.4',
        'setproctitle>=1.3.3',
        'typer>=0.15',
        'zstandard>=0.22.0',
    ],
    python_requires='>=3.11',
    packages=find_packages(exclude=['test']),
    package_data={
        NAME: [
            'py.typed',
            '__init__.pyi',
            'gamepad.yaml',
            'locale/*.po',
            'report/*.html',
            'report/*.css',
            'report/*.txt',
            'browser/page.*',
            'study/*.html',
            'study/*.yaml',
            'study/analysis.R',
        ]
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/launch', glob('launch/*.launch.py')),
        (f'share/{NAME}/viewers', glob('viewers/*')),
    ],
    extras_require={
        'browser': ['nicegui>=3'],
        'study': ['pyreadstat', 'statsmodels>=0.14.1'],
        'dask': ['dask', 'distributed'],
        'minari': ['minari[arrow]'],
        'parquet': ['pyarrow'],
    },
    entry_points={
        'console_scripts': SCRIPTS,
    },
)
